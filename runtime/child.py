"""A process beside a service: started, bounded, talked to, ended with its group.

Guests (:mod:`runtime.sandbox`), the key maker (:mod:`runtime.keys.worker`) and the heavy
eavesdroppers (:mod:`tap_service.heavy`) are such children. A child is asked on its standard input
and answers on its standard output. It ends when its input does, so none outlives its service.
"""

import ctypes
import os
import pickle
import resource
import select
import signal
import struct
import subprocess
import sys
import weakref
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

END_S: Final = 5.0
"""Seconds that a child has to end by itself once its input is closed, if not told otherwise."""

LENGTH: Final = struct.Struct(">I")
"""What a message begins with: its bytes."""

PR_SET_PDEATHSIG: Final = 1
_PR_SET_DUMPABLE: Final = 4


class Line:
    """Messages to and fro over two pipes, each after its length.

    Parameters
    ----------
    read, write : int
        File descriptors.
    """

    def __init__(self, read: int, write: int) -> None:
        self.read, self.write = read, write
        self._heard = select.poll()
        self._heard.register(read, select.POLLIN)

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Whether a message is there, or the other side gone, within so many seconds."""
        return bool(self._heard.poll(timeout_s * 1000))

    def send(self, value: object) -> None:
        """Say something, pickled.

        Raises
        ------
        OSError
            When the other side is gone.
        """
        self.send_bytes(pickle.dumps(value))

    def recv(self) -> Any:
        """What the other side said, unpickled: only of a side that runs no user's code.

        Raises
        ------
        EOFError, OSError
            When it is gone.
        """
        return pickle.loads(self.recv_bytes())

    def send_bytes(self, body: bytes) -> None:
        """Say so many bytes; raises as :meth:`send` does."""
        data = memoryview(LENGTH.pack(len(body)) + body)
        while data:
            data = data[os.write(self.write, data) :]

    def recv_bytes(self) -> bytes:
        """The bytes of one message; raises as :meth:`recv` does."""
        (length,) = LENGTH.unpack(self._read(LENGTH.size))
        return self._read(length)

    def _read(self, length: int) -> bytes:
        parts: list[bytes] = []
        while length:
            part = os.read(self.read, length)
            if not part:
                raise EOFError
            parts.append(part)
            length -= len(part)
        return b"".join(parts)


class Child:
    """A process that runs a module as a program, in a group of its own: Ctrl-C is not for it.

    Parameters
    ----------
    module : str
    arguments : sequence of str
    own_session : bool
        In a session of its own too. Linux divides the processors among sessions first (autogroup):
        there it weighs as much as the service. With the key maker in a session of its own an offer
        was half a millisecond late while both ends distilled.
    quiet : bool
        What it writes to standard error is dropped.

    Attributes
    ----------
    line : Line
        To it and from it.
    pid : int
    """

    def __init__(
        self,
        module: str,
        arguments: Sequence[str] = (),
        *,
        own_session: bool = False,
        quiet: bool = False,
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            start_new_session=own_session,
            process_group=None if own_session else 0,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # one processor is all it may take
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self.pid = self._process.pid
        self.line = Line(self._process.stdout.fileno(), self._process.stdin.fileno())
        self._forgotten = weakref.finalize(self, _end, self._process, END_S)

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._forgotten.alive and self._process.poll() is None

    def wait(self, timeout_s: float) -> int:
        """Its exit code; negative is the signal that ended it.

        Raises
        ------
        subprocess.TimeoutExpired
            When it goes on.
        """
        return self._process.wait(timeout_s)

    def end(self, within_s: float = END_S) -> int:
        """Close its input; kill its group where it does not end within so many seconds.

        Returns
        -------
        int
            Its exit code; negative is the signal that ended it.
        """
        self._forgotten.detach()
        return _end(self._process, within_s)


def _end(process: "subprocess.Popen[bytes]", within_s: float) -> int:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    with suppress(ProcessLookupError, PermissionError):  # one that is stopped would not notice
        os.killpg(process.pid, signal.SIGCONT)
    try:
        return process.wait(within_s)
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        return process.wait()


# --- the child's side -----------------------------------------------------------------------------


def ignore_signals() -> None:
    """End with the service, and not before: neither a terminal nor a supervisor ends this."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def take_line() -> Line:
    """The line to the service; what this process prints from now on leads nowhere."""
    line = Line(os.dup(0), os.dup(1))
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.close(nothing)
    return line


def die_with(parent: int) -> None:
    """End this process at once when the thread of ``parent`` that started it ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def leave_no_image() -> None:
    """Leave no core file, and let no process of this user look into this one's memory."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0)


def limit_memory(size: int) -> None:
    """Allow so many bytes of address space, and no core file."""
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
