"""Code that a user brought, in a process of its own, bounded in time and memory.

It stops itself alone: whether it exits, loops for ever, eats memory, forks, closes its streams or
floods what it is asked for, whoever asked is told in a line, and goes on. What it answers is read
as JSON and checked by the asker, never unpickled. It runs as the user who started the service, so
it may read that user's files: a bound for mistakes, and no wall against malice.

Two processes stand behind it. The guest runs the code. Its *supervisor* runs none: every process
that the guest started comes to be its child sooner or later, also one that called ``setsid`` (it is
their subreaper), and it kills them all once the guest or whoever asks is gone. It watches their
processor time as well: threads and children that go on between two answers are not for ever.
"""

import ctypes
import json
import os
import pickle
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from runtime.child import (
    LENGTH,
    PR_SET_PDEATHSIG,
    Child,
    Line,
    ignore_signals,
    limit_memory,
    take_line,
)
from runtime.errors import Failure
from runtime.processor_time import PROCESSOR_S, Meter, children_of, processes, used_s

START_S: Final = 20.0
"""Seconds that a guest has to be loaded and made."""

MEMORY: Final = 2 * 2**30
"""Bytes of address space that a guest has, if not told otherwise."""

ANSWER: Final = 8 * 2**20
"""Bytes of an answer at most."""

FORKS: Final = 64
"""Processes that a guest may start beside those of its user; root is not held to it."""

POLL_S: Final = 1.0
"""Seconds after which the supervisor looks at the processor time again."""

OVERSPENT: Final = 3
"""The supervisor's exit code where a guest has used too much processor time."""

SLICE_S: Final = 0.2
"""Seconds of a slice of waiting."""

_PR_SET_CHILD_SUBREAPER: Final = 36


class SandboxError(Failure):
    """A guest did not answer as it should; the text says how.

    Attributes
    ----------
    kind : str
        What the guest said it was; ``ended`` where it is at its end.
    """

    def __init__(self, text: str, kind: str = "ended") -> None:
        super().__init__(text)
        self.kind = kind


class SandboxProcess:
    """A guest's process: asks it, waits so long, and ends it with all that it started.

    Parameters
    ----------
    module : str
        Run as a program; it calls :func:`serve`.
    arguments : sequence of str
        The program's.
    memory : int
        Bytes of address space.
    """

    def __init__(self, module: str, arguments: Sequence[str] = (), memory: int = MEMORY) -> None:
        self.like = _like(module, tuple(arguments), memory)
        self.child = Child(module, (str(memory), *arguments), own_session=True, quiet=True)
        self._to, self._from = self.child.line.write, self.child.line.read
        os.set_blocking(self._to, False)
        os.set_blocking(self._from, False)
        self._sent, self._heard = select.poll(), select.poll()
        self._sent.register(self._to, select.POLLOUT)
        self._heard.register(self._from, select.POLLIN)
        self._closed = False
        self._code = 0

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return not self._closed and self.child.alive

    def close(self) -> None:
        """Let go of the supervisor, which ends everything."""
        if not self._closed:
            self._closed, self._code = True, self.child.end()

    def ask(self, what: str, argument: object, within_s: float) -> Any:
        """Its answer.

        Raises
        ------
        SandboxError
            When there is none in time, or it is none; the guest is then at its end. Also with what
            it raised, and of which ``kind``.
        """
        if self._closed:
            raise SandboxError("the process ended")
        patience = _Patience(within_s)
        try:
            self._send(what, argument, within_s, patience)
            answer = json.loads(self._receive(patience))
            kind, value = answer["kind"], answer["value"]
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            self.close()
            known = isinstance(error, _Ended | TimeoutError)
            text = f"{error} within {within_s:g} s" if isinstance(error, TimeoutError) else error
            if self._code == OVERSPENT:
                text = f"more than {PROCESSOR_S:g} s of processor time beside its answers"
                known = True
            raise SandboxError(str(text) if known else "an answer that is none") from None
        if kind != "value":
            raise SandboxError(str(value), str(kind))
        return value

    def begin(self, what: str, argument: object, within_s: float) -> None:
        """Ask, and wait for no answer: what it costs the guest is counted all the same.

        Raises
        ------
        TimeoutError
            When the guest does not read.
        """
        self._send(what, argument, within_s, _Patience(within_s))

    def _send(self, what: str, argument: object, within_s: float, patience: "_Patience") -> None:
        body = pickle.dumps((what, argument, within_s))
        data = memoryview(LENGTH.pack(len(body)) + body)
        while True:
            with suppress(BlockingIOError):
                data = data[os.write(self._to, data) :]
            if not data:
                return
            patience.wait(self._sent, "too slow: it does not read")

    def _receive(self, patience: "_Patience") -> bytes:
        (length,) = LENGTH.unpack(self._read(LENGTH.size, patience))
        if length > ANSWER:
            raise ValueError(f"an answer of {length} bytes")
        return self._read(length, patience)

    def _read(self, length: int, patience: "_Patience") -> bytes:
        parts: list[bytes] = []
        while length:
            patience.wait(self._heard, "too slow: no answer")
            part = os.read(self._from, length)
            if not part:
                raise _Ended("the process ended")
            parts.append(part)
            length -= len(part)
        return b"".join(parts)


_Like = tuple[str, tuple[str, ...], int, Path]

idle: dict[_Like, SandboxProcess] = {}
"""Idle processes, one of a kind, for reuse: a sweep makes one guest after the other."""


def _like(module: str, arguments: tuple[str, ...], memory: int) -> _Like:
    """What two processes of a kind share; the folder too, for one that is gone fails its guests."""
    return module, arguments, memory, Path.cwd()


def acquire(module: str, arguments: tuple[str, ...] = (), memory: int = MEMORY) -> SandboxProcess:
    """A :class:`SandboxProcess` that was given back, or a new one."""
    waiting = idle.pop(_like(module, arguments, memory), None)
    if waiting is not None and waiting.alive:
        return waiting
    return SandboxProcess(module, arguments, memory)


def give_back(process: SandboxProcess) -> None:
    """Keep a process that lives for the next of its kind, where none is kept."""
    if not process.alive or idle.setdefault(process.like, process) is not process:
        process.close()


class _Ended(OSError):
    """The other side of the pipe is gone."""


class _Patience:
    """Seconds to wait, counted in slices: a standstill of the whole machine counts as one slice."""

    def __init__(self, seconds: float) -> None:
        self._left = seconds

    def wait(self, poll: "select.poll", what: str) -> None:
        """Wait until something can be read or written.

        Raises
        ------
        TimeoutError
            With ``what``, when the time is over.
        """
        while self._left > 0:
            slice_s = min(self._left, SLICE_S)
            before = time.monotonic()
            if poll.poll(slice_s * 1000):
                return
            self._left -= min(time.monotonic() - before, 2 * slice_s)
        raise TimeoutError(what)


# --- the guest's side -----------------------------------------------------------------------------


def serve(
    answer: Callable[[str, Any], object], known: tuple[tuple[type[Exception], str], ...] = ()
) -> None:
    """Become a supervisor and its guest; the guest answers until whoever asks is gone.

    ``sys.argv`` begins with the bytes of address space.

    Parameters
    ----------
    answer : callable
        Takes what is asked and its argument; what it returns must be JSON.
    known : tuple of (exception type, kind)
        What is told under a kind of its own, with its text alone.
    """
    memory = int(sys.argv.pop(1))
    _weigh_as_nice()
    ignore_signals()
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1)
    meter = Meter()
    supervisor = os.getpid()
    guest = os.fork()
    if guest:
        os.close(1)  # so that its end is seen when the guest closes its own
        os._exit(_guard(guest, meter))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != supervisor:
        os._exit(1)
    limit_memory(memory)
    _limit_forks()
    line = take_line()
    try:
        _answer_all(answer, known, line, meter)
    finally:
        os._exit(0)  # threads and atexit functions of the user's code end here as well


def _weigh_as_nice() -> None:
    """Give this session the niceness that its first process was given.

    Linux divides the processors among sessions first, and a new one begins as nice as any: a guest
    of a tap that gives way to the loop would get as much as the plant.
    """
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    if niceness > 0:
        with suppress(OSError):  # a kernel without autogroup
            Path("/proc/self/autogroup").write_text(str(niceness))


def _limit_forks() -> None:
    mine = sum(_tasks_of(os.getuid()))
    _, most = resource.getrlimit(resource.RLIMIT_NPROC)
    room = mine + FORKS
    if most in (resource.RLIM_INFINITY, -1) or room < most:
        resource.setrlimit(resource.RLIMIT_NPROC, (room, room))


def _tasks_of(user: int) -> Iterator[int]:
    """Threads of each process of a user."""
    for process in processes():
        with suppress(OSError):
            if process.stat().st_uid == user:
                yield len(list((process / "task").iterdir()))


def _guard(guest: int, meter: Meter) -> int:
    """Wait until the guest is gone or whoever asks it, and leave no process behind.

    Returns
    -------
    int
        The exit code: :data:`OVERSPENT`, or 0.
    """
    code = 0
    told, tell = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.set_wakeup_fd(tell)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    watched = select.poll()
    watched.register(0, 0)  # the pipe of the questions: its other end closes with the asker
    watched.register(told, select.POLLIN)
    with suppress(ChildProcessError):
        while guest not in _dead() and all(fd == told for fd, _ in watched.poll(POLL_S * 1000)):
            with suppress(BlockingIOError):
                os.read(told, 4096)
            if meter.overspent(used_s(), time.monotonic()):
                code = OVERSPENT
                break
        # Whatever is left has an ancestor that is a child: without a child nothing is left.
        while True:
            for pid in children_of(os.getpid()):
                with suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            _dead()
            time.sleep(0.001)
    return code


def _dead() -> list[int]:
    """Children that have ended, and are waited for by this.

    Raises
    ------
    ChildProcessError
        When there is no child any more.
    """
    found = []
    while pid := os.waitpid(-1, os.WNOHANG)[0]:
        found.append(pid)
    return found


def _answer_all(
    answer: Callable[[str, Any], object],
    known: tuple[tuple[type[Exception], str], ...],
    line: Line,
    meter: Meter,
) -> None:
    while True:
        try:
            what, argument, within_s = line.recv()
        except EOFError:
            return
        meter.ask(within_s, time.monotonic(), time.process_time())
        try:
            told = {"kind": "value", "value": answer(what, argument)}
            body = json.dumps(told, default=float).encode()
        except Exception as error:
            found = next((kind for type_, kind in known if isinstance(error, type_)), "raised")
            text = " ".join(str(error).split())
            if found == "raised":
                text = f"{type(error).__name__}: {text}"
            body = json.dumps({"kind": found, "value": text[:2000]}).encode()
        line.send_bytes(body)
        meter.answer(time.monotonic())
