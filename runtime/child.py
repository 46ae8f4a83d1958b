"""A process beside a service: started, talked to, ended with its group, and bounded if need be.

The heavy eavesdroppers (:mod:`tap_service.heavy`) run in a :class:`Child`, a user's eavesdropper in
a :class:`Guest`. A child is asked and answers on a socket of its own, the number of which is its
last argument. It ends when the other end is closed, so none outlives its service.

A guest has so much memory, and so many seconds for each answer; then its process group is killed.
What it answers is read as JSON and never unpickled. It runs with the rights of the user who started
the service: these bounds are for mistakes, and no wall against malice.
"""

import ctypes
import json
import os
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from typing import Any, Final

from runtime.errors import GuestError

END_S: Final = 5.0
"""Seconds that a child has to end by itself once its line is closed, if not told otherwise."""

START_S: Final = 20.0
"""Seconds that a guest has to be loaded and made."""

MEMORY: Final = 2 * 2**30
"""Bytes of address space that a guest has."""

ANSWER: Final = 8 * 2**20
"""Bytes of a guest's answer at most."""

AFTERWARDS_S: Final = 0.2
"""Seconds that a guest has once more: its time may have gone by while the machine stood still."""

_PR_SET_PDEATHSIG: Final = 1


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
    line : Connection
        To it and from it.
    pid : int
    """

    def __init__(self, module: str, arguments: Sequence[str] = (), *, quiet: bool = False) -> None:
        self.line, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL if quiet else None,
            pass_fds=(theirs.fileno(),),
            process_group=0,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # one processor is all it may take
        )
        theirs.close()
        self.pid = self._process.pid
        self._forgotten = weakref.finalize(self, _end, self._process, self.line, END_S)

    def end(self, within_s: float = END_S) -> int:
        """Close its line; kill its group where it does not end within so many seconds.

        Returns
        -------
        int
            Its exit code; negative is the signal that ended it.
        """
        self._forgotten.detach()
        return _end(self._process, self.line, within_s)


def _end(process: "subprocess.Popen[bytes]", line: Any, within_s: float) -> int:
    line.close()
    with suppress(ProcessLookupError, PermissionError):  # one that is stopped would not notice
        os.killpg(process.pid, signal.SIGCONT)
    try:
        return process.wait(within_s)
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        return process.wait()


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
        line = self.child.line
        try:
            line.send((what, argument))
            if not (line.poll(within_s) or line.poll(AFTERWARDS_S)):
                raise TimeoutError
            answer = json.loads(line.recv_bytes(ANSWER))
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


# --- the child's side -----------------------------------------------------------------------------


def ignore_signals() -> None:
    """End with the service, and not before: neither a terminal nor a supervisor ends this."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def line_of_child() -> Connection:
    """The line to the service, in the child."""
    return Connection(int(sys.argv[-1]))


def die_with(parent: int) -> None:
    """End this process at once when the thread of ``parent`` that started it ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


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
    line = line_of_child()
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
