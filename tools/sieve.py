"""Runs mutants against tests, a test file at a time.

``python -m tools.sieve CHOSEN TRIED TESTS...`` is what ``tools.mutants`` calls. A test file's tests
run once as they are, which says what each takes, and once more while it is noted which lines each
reaches. Then each mutant that still lives is switched on in a fork, where those tests run that
reach the statement it changes, until one fails: first those that noticed another mutant of its
function, then the quickest. Limits are of processor time, so that a machine that is busy or a job
that is paused kills nothing.

Tests of the tests, marked ``wrong_on_purpose``, judge none: in the file with all mutants they would
not find the text that they replace. A test that fails without a mutant is told, and judges none
either; the exit code is then :data:`LEFT_OUT`.
"""

import gc
import hashlib
import json
import os
import resource
import signal
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import accumulate, groupby
from pathlib import Path
from types import FrameType
from typing import Any, Final, NamedTuple

import pytest

from runtime.processor_time import used_by_s

ARGUMENTS: Final = (
    "-q",
    "-s",
    "-p",
    "no:cacheprovider",
    "-m",
    "not integration and not wrong_on_purpose",
    "--timeout=0",
    "--tb=native",  # another kind reads the whole file of mutants, for a second of processor
    "-o",
    "tmp_path_retention_policy=none",
)
MEMORY: Final = 4 << 30
MEMORY_DISK: Final = Path("/dev/shm")
"""Where tests' files are, if it is there: on a disk they wait ten times as long as they work."""

WAIT_S: Final = 120.0
"""For a mutant that waits for what never comes: it and all that it started stand still so long."""

POLL_S: Final = 1.0
"""How often it is looked whether they do."""

UNTOLD: Final = 200
"""Exit code of a fork in which a mutant died, where the number of the test is not told."""

LEFT_OUT: Final = 10
"""Exit code where a test failed without a mutant."""

AFFORDED_S: Final = 12.0
"""Of processor time, which the tests of one file that judge one mutant take, the quickest first."""


class Chosen(NamedTuple):
    """A mutant to be tried: its name, its key, and the lines of the statement that it changes."""

    name: str
    key: str
    first: int
    last: int

    @property
    def module(self) -> str:
        """Where it is."""
        return self.name.rpartition(".")[0]

    @property
    def function(self) -> str:
        """The function that it changes."""
        return self.name.partition("__mutmut_")[0]

    def is_reached(self, lines: Mapping[str, set[int]]) -> bool:
        """Whether its statement is among the lines, by module."""
        return not lines.get(self.module, set()).isdisjoint(range(self.first, self.last + 1))


class Sieve:
    """Pytest's loop over the tests, in which mutants die.

    Parameters
    ----------
    chosen : list of Chosen
    tried : Path
        What became of each so far, and which test files it has outlived; lines are added.
    """

    def __init__(self, chosen: list[Chosen], tried: Path) -> None:
        self._tried = tried
        lines = tried.read_text().splitlines() if tried.exists() else []
        rows = [json.loads(line) for line in lines]
        outlived = [row for row in rows if "outlived" in row]
        self._outlived = {tuple(row["outlived"]) for row in outlived}
        fate = {row["key"]: row["fate"] for row in rows if "fate" in row}
        self._alive = [m for m in chosen if fate.get(m.key) not in ("killed", "timeout")]
        self._reached = {row["outlived"][0] for row in outlived if row.get("reached", True)}
        self._unfit: list[pytest.Item] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_configure(self) -> None:
        """Examples are the same ones each time, and a failing one is not made smaller."""
        from hypothesis import HealthCheck, Phase, settings

        settings.register_profile(
            "mutants",
            deadline=None,
            database=None,
            derandomize=True,
            phases=(Phase.explicit, Phase.generate),
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
        )
        settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """All test files, and all mutants through each."""
        files = [(path, list(items)) for path, items in groupby(session.items, lambda i: i.path)]
        for number, (path, items) in enumerate(files):
            after = files[number + 1][1][0] if number + 1 < len(files) else None
            self._file(path, items)
            session._setupstate.teardown_exact(after)
        for m in self._alive:
            fate = "survived" if m.key in self._reached else "not reached"
            self._note({"key": m.key, "fate": fate})
        for item in self._unfit:
            print(f"{item.nodeid} fails without a mutant: it judged none")
        session.testsfailed = len(self._unfit)
        return True

    def _file(self, path: Path, items: list[pytest.Item]) -> None:
        text = path.read_bytes() + b"".join(
            p.read_bytes() for p in sorted(path.parent.glob("*.py")) if "test_" not in p.name
        )
        digest = hashlib.sha256(text).hexdigest()[:12]
        due = [m for m in self._alive if (m.key, path.name, digest) not in self._outlived]
        if not due:
            return
        reach, cost = self._as_it_is(items)
        reached, judges = self._judges(due, reach, cost)
        is_whole = len(cost) == len(items)
        gc.collect()
        gc.freeze()
        began, dead, parted = time.process_time(), set(), 0
        noticed: Counter[tuple[str, pytest.Item]] = Counter()
        for m in due:
            tests = judges[m.key]
            tests.sort(key=lambda i: -noticed[m.function, i])
            fate, by = self._fate(m.name, tests, cost) if tests else ("survived", None)
            if by is not None:
                noticed[m.function, by] += 1
            if fate != "survived":
                dead.add(m.key)
                self._note({"key": m.key, "fate": fate})
                continue
            parted += len(tests) < len(reached[m.key])
            if is_whole:
                self._note(
                    {"outlived": [m.key, path.name, digest], "reached": bool(reached[m.key])}
                )
        self._alive = [m for m in self._alive if m.key not in dead]
        took = time.process_time() - began + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
        print(
            f"{path.name}: {len(dead)} of {len(due)} died, {len(self._alive)} live on, "
            f"{parted} of them for a part of the tests that reach them "
            f"({took:.0f} s of processor so far)",
            flush=True,
        )

    def _as_it_is(
        self, items: list[pytest.Item]
    ) -> tuple[dict[pytest.Item, dict[str, set[int]]], dict[pytest.Item, float]]:
        """The lines that each reaches, by module, and what it takes; of those that pass."""
        reach, cost = {}, {}
        for item, following in _in_turn(items):
            began = time.process_time()
            if _passes(item, following, say=True):
                cost[item] = time.process_time() - began
            else:
                self._leave_out(item)
        for item, following in _in_turn(list(cost)):
            with _lines_noted() as lines:
                _passes(item, following)
            reach[item] = dict(lines)
        return reach, cost

    def _judges(
        self,
        due: list[Chosen],
        reach: Mapping[pytest.Item, Mapping[str, set[int]]],
        cost: dict[pytest.Item, float],
    ) -> tuple[dict[str, list[pytest.Item]], dict[str, list[pytest.Item]]]:
        """The tests that reach each mutant, and those that judge it: they pass in a fork.

        One that does not is taken out of ``cost``; where it is not known which, all are.
        """
        while True:
            reached = {m.key: [i for i in cost if m.is_reached(reach[i])] for m in self._alive}
            judges = {m.key: afforded(reached[m.key], cost) for m in due}
            asked = list(dict.fromkeys(i for tests in judges.values() for i in tests))
            fate, by = self._fate("", asked, cost)
            if fate == "survived":
                self._reached |= {key for key, tests in reached.items() if tests}
                return reached, judges
            for item in asked if by is None else [by]:
                self._leave_out(item)
                del cost[item]

    def _leave_out(self, item: pytest.Item) -> None:
        print(f"{item.nodeid} fails without a mutant", flush=True)
        self._unfit.append(item)

    def _note(self, row: Mapping[str, object]) -> None:
        with self._tried.open("a") as log:
            print(json.dumps(row), file=log)

    def _fate(
        self, name: str, items: list[pytest.Item], cost: Mapping[pytest.Item, float]
    ) -> tuple[str, pytest.Item | None]:
        """What becomes of a mutant, and which test noticed it where that is known."""
        from mutmut.mutation.trampoline import set_mutant_under_test

        child = os.fork()
        if child == 0:
            code = UNTOLD
            try:
                quiet = os.open(os.devnull, os.O_RDWR)
                os.dup2(quiet, 1)
                os.dup2(quiet, 2)
                signal.signal(signal.SIGPROF, signal.SIG_DFL)
                resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
                set_mutant_under_test(name)
                for place, (item, following) in enumerate(_in_turn(items)):
                    signal.setitimer(signal.ITIMER_PROF, 1 + 10 * cost[item])
                    if not _passes(item, following):
                        code = min(1 + place, UNTOLD)
                        break
                else:
                    code = 0
            finally:
                os._exit(code)
        ended = waited_for(child)
        if ended is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "timeout", None
        fate = "survived" if ended == 0 else "timeout" if ended == -signal.SIGPROF else "killed"
        return fate, items[ended - 1] if 0 < ended < UNTOLD else None


def waited_for(child: int) -> int | None:
    """The exit code of a process; None once it has stood still for `WAIT_S`, and lives."""
    waited, nap, looked, used = 0.0, 0.002, 0.0, 0.0
    while waited < WAIT_S:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(nap)
        waited, nap = waited + nap, min(0.02, nap * 1.5)
        if waited - looked >= POLL_S:
            now = used_by_s(child)
            waited, looked = (0.0, 0.0) if now > used else (waited, waited)
            used = now
    return None


def afforded(items: list[pytest.Item], cost: Mapping[pytest.Item, float]) -> list[pytest.Item]:
    """The quickest of them, as many as :data:`AFFORDED_S` is enough for."""
    items = sorted(items, key=cost.__getitem__)
    until = accumulate(cost[i] for i in items)
    return [i for i, spent in zip(items, until, strict=True) if spent <= AFFORDED_S]


@contextmanager
def _lines_noted() -> Iterator[dict[str, set[int]]]:
    """The lines of unmutated functions that are reached meanwhile, by module."""
    lines: dict[str, set[int]] = defaultdict(set)

    def called(frame: FrameType, _event: str, _told: object) -> Any:
        if "__mutmut_orig" not in frame.f_code.co_qualname:
            return None
        note = lines[frame.f_globals["__name__"]].add

        def went(frame: FrameType, _event: str, _told: object) -> Any:
            note(frame.f_lineno)
            return went

        return went

    threading.settrace(called)
    sys.settrace(called)
    try:
        yield lines
    finally:
        sys.settrace(None)
        threading.settrace(None)


def _in_turn(items: list[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item]]:
    """Each with one that follows, so that what a test file shares is not taken down."""
    return zip(items, [*items[1:], *items[:1]], strict=True)


def _passes(item: pytest.Item, following: pytest.Item, *, say: bool = False) -> bool:
    from _pytest.runner import runtestprotocol

    failed = [r for r in runtestprotocol(item, log=False, nextitem=following) if r.failed]
    if failed and say:
        print(failed[0].longreprtext)
    return not failed


def main(argv: Iterable[Any]) -> int:
    """Sift the chosen mutants through the tests."""
    chosen, tried, *tests = map(str, argv)
    sieve = Sieve([Chosen(*row) for row in json.loads(Path(chosen).read_text())], Path(tried))
    with tempfile.TemporaryDirectory(dir=MEMORY_DISK if MEMORY_DISK.is_dir() else None) as apart:
        tempfile.tempdir = apart
        code = pytest.main([*ARGUMENTS, f"--basetemp={apart}/tmp", *tests], plugins=[sieve])
    return LEFT_OUT if code == pytest.ExitCode.TESTS_FAILED else int(code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
