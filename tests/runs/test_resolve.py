"""What a kill leaves in a trace is resolved once, and alike for who counts and who checks."""

from pathlib import Path
from typing import Any

import pytest

from runtime.recording import TraceError
from runtime.run_folder import PLANT_TRACE
from tests.support.recorded_pair import Fault, RecordedPair
from tests.support.traces import Event, Resolved, read_trace
from wyner.runs.run import Run, RunError

S, T = "1" * 16, "2" * 16
AGAIN = {"event": "continued"}


def step(j: int, k: int, session: str = S, **more: Any) -> Event:
    return {"event": "transition", "session": session, "j": j, "k": k, **more}


def missed(k: int, session: str = S, **more: Any) -> Event:
    return {"event": "missed", "session": session, "k": k, **more}


def report(text: str) -> Event:
    return {"event": "recovered", "payload": text}


def told(*lines: Event) -> tuple[list[Event], int]:
    resolved = Resolved(lines)
    return list(resolved), resolved.behind


def test_a_step_that_is_traced_again_counts_once_as_it_stands_last() -> None:
    lines = step(0, 0), step(1, 1, coin=0), AGAIN, step(1, 1, coin=1), step(2, 2)
    assert told(*lines) == ([step(0, 0), step(1, 1, coin=1), step(2, 2)], 0)


def test_a_missed_step_that_was_never_saved_gives_way_to_what_it_became() -> None:
    lines = step(0, 0), missed(1), AGAIN, step(0, 0), step(1, 1)
    assert told(*lines) == ([step(0, 0), step(1, 1)], 0)
    lines = step(0, 0), missed(1, x=1), AGAIN, missed(1, x=2), missed(2)
    assert told(*lines) == ([step(0, 0), missed(1, x=2), missed(2)], 0)
    # without a restart it is another step, whatever its number: a check says so
    assert len(told(step(0, 0), missed(1), missed(1))[0]) == 3


def test_a_report_comes_once_though_its_transition_came_twice() -> None:
    lines = step(0, 0), report("a"), AGAIN, step(0, 0), report("a"), step(1, 1), report("b")
    assert told(*lines) == ([step(0, 0), report("a"), step(1, 1), report("b")], 0)


def test_an_end_that_was_put_back_counts_nothing_until_its_session_is_over() -> None:
    first = [step(j, j) for j in range(5)]
    again = [step(j, j) for j in range(2, 5)]
    after = [{"event": "session", "session": T, "reason": "stale"}, step(0, 5, T)]
    lines = (*first, AGAIN, *again, report("stale"), *after)
    assert told(*lines) == ([*first, *after], 3)


def test_a_plant_that_lost_its_journal_begins_again() -> None:
    lines = step(0, 0), step(1, 1), AGAIN, step(0, 0, T), missed(1, T)
    assert told(*lines) == ([step(0, 0), step(1, 1), step(0, 0, T), missed(1, T)], 0)


FAULTS: dict[str, dict[int, Fault]] = {
    "none": {},
    "deaths": {5: "plant dies", 6: "plant dies", 20: "controller dies", 31: "offer lost"},
    "a lost journal": {10: "plant dies", 25: "plant forgets", 40: "offer lost", 41: "plant dies"},
    "an older copy": {10: "journal copied", 30: "journal put back", 45: "plant dies"},
}


@pytest.mark.parametrize("faults", FAULTS.values(), ids=FAULTS)
def test_who_counts_and_who_checks_take_the_same_steps(
    tmp_path: Path, faults: dict[int, Fault]
) -> None:
    run = RecordedPair(tmp_path, b"a", b"b")
    run.steps(120, faults)
    run.stop()
    events = read_trace(tmp_path / PLANT_TRACE).events
    mine = [
        (e["event"], e["session"], e["k"])
        for e in events
        if e["event"] in ("transition", "missed", "interrupted")
    ]
    trace = Run.load(tmp_path).read("plant")
    kinds = ("transition", "missed", "interrupted")
    assert mine == [(kinds[row["kind"]], *trace.where(row)) for row in trace.rows]
    reports = list(trace.told("recovered"))
    assert len(reports) == sum(e["event"] == "recovered" for e in events)


def test_what_no_plant_wrote_is_one_line_that_names_the_trace(tmp_path: Path) -> None:
    run = RecordedPair(tmp_path, b"hi")
    run.steps(4)
    run.stop()
    whole = (tmp_path / PLANT_TRACE).read_bytes().splitlines(keepends=True)
    wrong = b'{"event":"transition","session":"1","k":1}\n'
    (tmp_path / PLANT_TRACE).write_bytes(b"".join([*whole[:3], wrong, *whole[3:]]))
    trace = Run.load(tmp_path).columns("plant")
    assert trace.unread.startswith("trace.jsonl line 4: a line is not as expected: ")
    assert "\n" not in trace.unread
    assert (len(trace.steps), len(trace.rows)) == (1, 4)
    with pytest.raises(TraceError, match="cannot be read"):
        Run.load(tmp_path / "plant").columns("plant")


def test_there_is_no_run_where_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no run here"):
        Run.load(tmp_path / "none")
