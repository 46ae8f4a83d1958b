"""A process beside a service: started, talked to, ended with its group, and bounded if need be.

The heavy eavesdroppers (:mod:`tap_service.heavy`) run in a :class:`Child`, a user's eavesdropper in
a :class:`Guest`. A child is asked on its standard input and answers on its standard output. It ends
when its input does, so none outlives its service.

A guest has so much memory, and so many seconds for each answer; then its process group is killed.
What it answers is read as JSON and never unpickled. It runs with the rights of the user who started
the service: these bounds are for mistakes, and no wall against malice.
"""

import ctypes
import json
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from runtime.errors import Failure

END_S: Final = 5.0
"""Seconds that a child has to end by itself once its input is closed, if not told otherwise."""

LENGTH: Final = struct.Struct(">I")
"""What a message begins with: its bytes."""

START_S: Final = 20.0
"""Seconds that a guest has to be loaded and made."""

MEMORY: Final = 2 * 2**30
"""Bytes of address space that a guest has."""

ANSWER: Final = 8 * 2**20
"""Bytes of a guest's answer at most."""

SLICE_S: Final = 0.2
"""Seconds of a slice of waiting; a standstill of the whole machine counts as one."""

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
        quiet: bool = False,
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            process_group=0,
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


class GuestError(Failure):
    """A guest did not answer as it should; the text says how.

    Attributes
    ----------
    kind : str
        What the guest said it was; ``ended`` where it is at its end.
    """

    def __init__(self, text: str, kind: str = "ended") -> None:
        super().__init__(text)
        self.kind = kind


class Guest:
    """Code that a user brought, in a bounded process of its own.

    Parameters
    ----------
    module : str
        Run as a program; it calls :func:`serve`.
    arguments : sequence of str
        The program's.
    """

    def __init__(self, module: str, arguments: Sequence[str] = ()) -> None:
        self.child = Child(module, arguments, quiet=True)
        os.set_blocking(self.child.line.write, False)
        self._ended = False

    def ask(self, what: str, argument: object, within_s: float) -> Any:
        """Its answer to a question.

        Raises
        ------
        GuestError
            When there is none in time, or it is none; the guest is then at its end. Also with what
            it raised, and of which ``kind``.
        """
        if self._ended:
            raise GuestError("the process ended")
        try:
            answer = json.loads(self._answer(pickle.dumps((what, argument)), within_s))
            kind, value = answer["kind"], answer["value"]
        except TimeoutError:
            self.end()
            raise GuestError(f"too slow: no answer within {within_s:g} s") from None
        except (OSError, EOFError):
            self.end()
            raise GuestError("the process ended") from None
        except (ValueError, LookupError, TypeError, RecursionError):
            self.end()
            raise GuestError("an answer that is none") from None
        if kind != "value":
            raise GuestError(str(value), str(kind))
        return value

    def end(self) -> None:
        """Kill it, and all of its group."""
        if not self._ended:
            self._ended = True
            self.child.end(0.0)

    def _answer(self, question: bytes, within_s: float) -> bytes:
        line, left_s = self.child.line, within_s
        unsaid = memoryview(LENGTH.pack(len(question)) + question)
        answer = bytearray()
        waiting = select.poll()
        while True:
            waiting.register(line.write if unsaid else line.read, WRITES if unsaid else READS)
            began = time.monotonic()
            ready = waiting.poll(1000 * min(left_s, SLICE_S))
            left_s -= min(time.monotonic() - began, 2 * SLICE_S)
            if not ready:
                if left_s <= 0:
                    raise TimeoutError
                continue
            if unsaid:
                unsaid = unsaid[os.write(line.write, unsaid) :]
                if not unsaid:
                    waiting.unregister(line.write)
                continue
            part = os.read(line.read, 65536)
            if not part:
                raise EOFError
            answer += part
            if len(answer) >= LENGTH.size:
                (length,) = LENGTH.unpack_from(answer)
                if length > ANSWER:
                    raise ValueError(f"an answer of {length} bytes")
                if len(answer) >= LENGTH.size + length:
                    return bytes(answer[LENGTH.size : LENGTH.size + length])


READS: Final = select.POLLIN
WRITES: Final = select.POLLOUT


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
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0)


def limit_memory(size: int) -> None:
    """Allow so many bytes of address space, and no core file."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def serve(
    answer: Callable[[str, Any], object], known: Sequence[tuple[type[Exception], str]] = ()
) -> None:
    """Answer a guest's questions until nobody asks any more.

    Parameters
    ----------
    answer : callable
        Runs the user's code: (what, argument) to a value that JSON can carry.
    known : sequence of (type, kind)
        What some exceptions are told as; all others are told as ``raised``, with their names.
    """
    die_with(os.getppid())
    ignore_signals()
    limit_memory(MEMORY)
    line = take_line()
    while True:
        try:
            what, argument = line.recv()
        except EOFError:
            os._exit(0)  # threads and atexit functions of the user's code end here as well
        try:
            body = json.dumps({"kind": "value", "value": answer(what, argument)}, default=float)
        except Exception as error:
            kind = next((kind for type_, kind in known if isinstance(error, type_)), "raised")
            text = " ".join(str(error).split())
            if kind == "raised":
                text = f"{type(error).__name__}: {text}"
            body = json.dumps({"kind": kind, "value": text[:2000]})
        line.send_bytes(body.encode())
