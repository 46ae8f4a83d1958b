"""A process beside a service: started, talked to, ended with its group, and bounded if need be.

A child is asked and answers on a socket of its own, the number of which is its last argument. It
ends when the other end is closed, so none outlives its service.

One that runs a user's code allows itself so much memory, and so many seconds for each answer. It
runs with the rights of the user who started the service: these bounds are for mistakes, and no wall
against malice.
"""

import os
import signal
import subprocess
import sys
import time
import weakref
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from typing import Any, Final

END_S: Final = 5.0
"""Seconds that a child has to end by itself once its line is closed, if not told otherwise."""

MEMORY: Final = 2 * 2**30
"""Bytes of address space of one that runs a user's code."""

LOOK_S: Final = 0.1
"""Seconds between two looks whether a child that says nothing is still there."""


class ChildProcess:
    """A process that runs a module as a program, in a group of its own: Ctrl-C is not for it.

    Parameters
    ----------
    module : str

    Attributes
    ----------
    line : Connection
        To it and from it.
    pid : int
    """

    def __init__(self, module: str) -> None:
        self.line, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(theirs.fileno(),),
            process_group=0,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # one processor is all it may take
        )
        theirs.close()
        self.pid = self._process.pid
        self._forgotten = weakref.finalize(self, _end, self._process, self.line, END_S)

    def poll(self, within_s: float) -> bool:
        """Whether it says something within so many seconds.

        Raises
        ------
        EOFError
            When it ended, and all that it said was taken. A process that it started may still hold
            the other end of the line.
        """
        until = time.monotonic() + within_s
        while not self.line.poll(min(max(0.0, until - time.monotonic()), LOOK_S)):
            if self._process.poll() is not None and not self.line.poll():
                raise EOFError
            if time.monotonic() >= until:
                return False
        return True

    def end(self, within_s: float = END_S) -> int:
        """Close its line; kill it where it does not end within so many seconds, and its group.

        Returns
        -------
        int
            Its exit code; negative is the signal that ended it.
        """
        if self._forgotten.detach() is None:  # it was ended before; its number may be another's
            return self._process.wait()
        return _end(self._process, self.line, within_s)


def _end(process: "subprocess.Popen[bytes]", line: Any, within_s: float) -> int:
    line.close()
    _signal_group(process, signal.SIGCONT)  # one that is stopped would not notice
    with suppress(subprocess.TimeoutExpired):
        process.wait(within_s)
    _signal_group(process, signal.SIGKILL)
    return process.wait()


def _signal_group(process: "subprocess.Popen[bytes]", number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


# --- the child's side -----------------------------------------------------------------------------


def ignore_signals() -> None:
    """End with the service, and not before: neither a terminal nor a supervisor ends this."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def line_of_child() -> Connection:
    """The line to the service, in the child."""
    return Connection(int(sys.argv[-1]))


def limit_memory() -> None:
    """Allow this process :data:`MEMORY`, and no core file."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def kill_after(seconds: float) -> None:
    """End this process, whatever it does, unless it says so again within so many seconds.

    The kernel does it, with SIGALRM. 0 takes it back.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds)
