"""Mutation testing: a sample is its seed's, and a mutant's fate is what the tests make it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tools import sieve
from tools.mutants import ROOMS, SOURCES, Mutant, changed, drawn, fates, generate, told
from tools.sieve import AFFORDED_S, LEFT_OUT, afforded

MUTANTS = [Mutant(f"room.m.x_f__mutmut_{i}", f"{i:016x}", "a", "b", 1, 1) for i in range(50)]


def test_a_sample_is_that_of_its_seed_and_a_larger_one_holds_it() -> None:
    first = drawn(MUTANTS, 10, 1)
    assert first == drawn(MUTANTS[::-1], 10, 1) == drawn(MUTANTS, 20, 1)[:10]
    assert len(set(first)) == 10
    assert first != drawn(MUTANTS, 10, 2)
    assert drawn(MUTANTS, None, 1) == MUTANTS
    assert set(drawn(MUTANTS, 60, 1)) == set(MUTANTS)


def test_what_was_tried_is_told_with_its_interval_and_the_survivors() -> None:
    fate = dict.fromkeys((m.key for m in MUTANTS[:7]), "killed")
    fate |= {MUTANTS[7].key: "timeout", MUTANTS[8].key: "survived", MUTANTS[9].key: "not reached"}
    changed = MUTANTS[8]._replace(
        before="def x_f__mutmut_orig():\n a\n b", after="def x_f__mutmut_8():\n a\n c"
    )
    tried = [*MUTANTS[:8], changed, *MUTANTS[9:20]]
    assert told("room", 50, tried, fate).splitlines() == [
        "room: 8 of 10 killed, 80.0% [44.4%, 97.5%], of 50 mutants",
        "  survived: room.m.x_f__mutmut_8",
        "    - b",
        "    + c",
        "  not reached: room.m.x_f__mutmut_9",
        "    -a",
        "    +b",
    ]
    assert told("room", 10, MUTANTS[:10], fate).startswith(
        "room: 8 of 10 killed, 80.0%, of 10 mutants"
    )
    assert told("room", 50, MUTANTS[20:], fate) == "room: none of 50 tried"


@pytest.mark.parametrize("room", ["link", "runs/check", "tap"])
def test_every_quick_test_file_of_a_room_judges_it(room: str) -> None:
    judges = {Path(name).name for names in ROOMS.values() for name in names}
    there = {path.name for path in Path(f"tests/{room}").glob("test_*.py")}
    slow = {
        "test_watched.py",
        "test_mutants.py",
        "test_key_checks.py",
        "test_evidence.py",
        "test_fleet.py",
        "test_guests.py",
        "test_service.py",
    }
    assert there - judges <= slow


@pytest.mark.parametrize("room", ROOMS)
def test_every_judge_and_every_source_of_a_room_is_there(room: str) -> None:
    assert [path for path in (*ROOMS[room], *SOURCES[room]) if not Path(path).exists()] == []


def test_a_mutant_is_judged_by_the_quickest_that_its_budget_is_enough_for() -> None:
    cost: dict[Any, float] = {"a": AFFORDED_S / 2, "b": 0.0, "c": AFFORDED_S / 4, "d": AFFORDED_S}
    judges: list[Any] = afforded(list(cost), cost)
    assert judges == ["b", "c", "a"]


@pytest.mark.long
def test_who_works_is_waited_for_and_who_stands_still_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a busy machine a second of work takes minutes."""
    monkeypatch.setattr(sieve, "WAIT_S", 2.0)
    monkeypatch.setattr(sieve, "POLL_S", 0.3)
    work = "import time\nwhile time.process_time() < 4: pass\nraise SystemExit(3)"
    for code, expected in ((work, 3), ("import time; time.sleep(1000)", None)):
        command = [sys.executable, "-c", code]
        child = os.posix_spawn(sys.executable, command, os.environ)
        assert sieve.waited_for(child) == expected
        if expected is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


FUNCTION = """    def x_f__mutmut_orig(a):
        if (
            a
            > 1
        ):
            return [
                1,
                2]
        return a
"""


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [("> 1", ">= 1", (1, 4)), ("2]", "3]", (5, 7)), ("return a", "return -a", (8, 8))],
)
def test_a_mutant_is_reached_where_the_statement_that_it_changes_is(
    old: str, new: str, lines: tuple[int, int]
) -> None:
    mutant = FUNCTION.replace("orig", "1").replace(old, new)
    assert changed(FUNCTION, mutant) == lines
    assert changed(FUNCTION, FUNCTION.replace("(a)", "(b)")) == (0, 8)


SOURCE = """
def lowered(n):
    while n > 9:
        n -= 3
    if n < -9:
        n += 1
    return n


def unheard_of(n):
    return n + 1
"""
TESTS = """
import pytest
from room.m import lowered


@pytest.fixture(scope="module")
def shared():
    yield [100]


def test_small(shared):
    assert lowered(5) == 5 and shared.pop() == 100
    shared.append(100)


def test_large(shared):
    assert lowered(shared[0]) == 7
"""

SURVIVORS = {"-    while n > 9:", "-    if n < -9:"}
"""What stands where these tests see no difference."""


def sifted(folder: Path, tests: str) -> tuple[list[Mutant], subprocess.CompletedProcess[str]]:
    """The mutants of the source, once they went through the tests."""
    pytest.importorskip("mutmut")
    for name in ("room/__init__.py", "tests/__init__.py", "tests/test_m.py", "pyproject.toml"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(tests if "test_m" in name else "")
    code, mutants = generate(SOURCE, Path("room/m.py"))
    (folder / "room/m.py").write_text(code)
    rows = [[m.name, m.key, m.first, m.last] for m in mutants]
    (folder / "chosen.json").write_text(json.dumps(rows))
    root = str(Path(__file__).resolve().parents[2])
    ended = subprocess.run(
        [sys.executable, "-m", "tools.sieve", "chosen.json", "tried.jsonl", "tests"],
        check=False,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": f"{folder}:{root}"},
        capture_output=True,
        text=True,
    )
    return mutants, ended


@pytest.mark.slow
def test_mutants_die_by_the_tests_that_reach_them(tmp_path: Path) -> None:
    """One that never ends dies as well; what no test calls is named so."""
    for _ in range(2):  # the second time, only survivors are known and nothing is tried again
        mutants, ended = sifted(tmp_path, TESTS)
        assert ended.returncode == 0, ended.stderr
    tried = tmp_path / "tried.jsonl"
    fate = fates(tried)
    assert set(fate) == {m.key for m in mutants}
    by = {m.name.removeprefix("room.m."): (fate[m.key], m.difference()) for m in mutants}
    of_lowered = {name: (f, d) for name, (f, d) in by.items() if name.startswith("x_lowered")}
    survivors = [d[0] for f, d in of_lowered.values() if f == "survived"]
    assert set(survivors) == SURVIVORS
    unreached = [d[0] for f, d in of_lowered.values() if f == "not reached"]
    assert set(unreached) == {"-        n += 1"}
    assert "timeout" in {f for f, _ in of_lowered.values()}
    assert {f for name, (f, _) in by.items() if name.startswith("x_unheard_of")} == {"not reached"}
    outlived = [line for line in tried.read_text().splitlines() if "outlived" in line]
    assert len(outlived) == len(set(outlived))


UNFIT = """

def test_wrong():
    assert lowered(5) == 6


def test_only_here(pid=os.getpid()):
    assert lowered(5) == 5 and os.getpid() == pid


@pytest.mark.wrong_on_purpose
def test_of_the_tests():
    assert lowered(5) == 7
"""


@pytest.mark.slow
def test_a_test_that_fails_without_a_mutant_is_told_and_judges_none(tmp_path: Path) -> None:
    """In the process itself or in a fork; a test of the tests is not even asked."""
    mutants, ended = sifted(tmp_path, f"import os\n{TESTS}{UNFIT}")
    assert ended.returncode == LEFT_OUT, ended.stderr
    lines = [line for line in ended.stdout.splitlines() if "fails without a mutant: " in line]
    assert {line.split()[0] for line in lines} == {
        "tests/test_m.py::test_wrong",
        "tests/test_m.py::test_only_here",
    }
    fate = fates(tmp_path / "tried.jsonl")
    of_lowered = [m for m in mutants if m.function.endswith("x_lowered")]
    survivors = {m.difference()[0] for m in of_lowered if fate[m.key] == "survived"}
    assert survivors == SURVIVORS, "the others judge as they do alone"
