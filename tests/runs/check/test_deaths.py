"""An honest run passes the check, wherever one of its ends was killed, and no report is lost."""

from pathlib import Path

import pytest

from protocol.link.events import RESUMED
from protocol.link.records import Side
from runtime.run_folder import PLANT_TRACE
from tests.support.checked_runs import failed
from tests.support.pair import SIDES, Name
from tests.support.recorded_pair import Lines, RecordedPair, edit, read_lines, write_lines
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence
from wyner.runs.run import Run

MESSAGES = [b"a", b"b", b"b"]


def killed_once(folder: Path, side: Side, since: str, after: int) -> RecordedPair:
    """A run of three messages; the operator hands the second over again if he gets no answer."""
    loop = RecordedPair(folder, MESSAGES[0], name="keys")
    loop.run(lambda: loop.transitions >= 3)
    loop.crash_at(side, after=after, since=since)
    loop.queue("second", MESSAGES[1])
    loop.run(lambda: loop.transitions >= 6)
    loop.queue("second", MESSAGES[1])
    loop.queue("third", MESSAGES[2])
    loop.run(lambda: loop.delivered >= 3)
    return loop


@pytest.mark.parametrize("after", range(4))
@pytest.mark.parametrize(
    ("side", "since"), [("plant", "recovered"), ("controller", "delivered"), ("controller", "sent")]
)
def test_no_report_is_lost_where_an_end_is_killed_about_it(
    tmp_path: Path, side: Side, since: str, after: int
) -> None:
    loop = killed_once(tmp_path, side, since, after)
    assert loop.lives[side] == 2
    assert (loop.plant.state.record.frame.messages, loop.received) == (3, MESSAGES)
    loop.stop()
    assert loop.wrong() == []
    run = Run.load(tmp_path)
    assert len(list(run.columns("plant").told("recovered"))) == 3
    assert len(list(run.columns("controller").told("delivered"))) == 3


def test_a_message_that_was_told_and_never_queued_may_be_passed_over(tmp_path: Path) -> None:
    loop = RecordedPair(tmp_path, MESSAGES[0], name="keys")
    loop.run(lambda: loop.transitions >= 3)
    loop.crash_at("controller", after=1, since="sent")
    loop.queue("given-up", b"b")
    loop.run(lambda: loop.lives["controller"] == 2)
    loop.queue("third", b"c")
    loop.run(lambda: loop.delivered >= 2)
    assert loop.received == [b"a", b"c"]
    loop.stop()
    assert loop.wrong() == []


def test_a_block_of_a_session_that_nobody_knows_fails(tmp_path: Path) -> None:
    loop = RecordedPair(tmp_path, name="keys")
    loop.run(lambda: loop.transitions >= 150)
    loop.stop()

    def change(lines: Lines) -> None:
        next(line for line in lines if line["event"] == "block")["session"] = "f" * 16

    edit(tmp_path / PLANT_TRACE, change)
    assert "blocks" in failed(tmp_path)


@pytest.mark.parametrize(("after", "reports"), [(1, 4), (2, 3)])
def test_a_report_that_is_taken_from_a_killed_run_is_missed(
    tmp_path: Path, after: int, reports: int
) -> None:
    """Where it was killed before it had saved, both were written again: the second counts."""
    loop = killed_once(tmp_path, "plant", "recovered", after)
    loop.stop()
    whole = read_lines(tmp_path / PLANT_TRACE)
    places = [i for i, line in enumerate(whole) if line["event"] == "recovered"]
    assert len(places) == reports
    gone = [line for i, line in enumerate(whole) if i != places[reports - 3]]
    write_lines(tmp_path / PLANT_TRACE, [line for line in gone if line["event"] != "end"])
    assert any("a whole frame, and nothing recovered" in line for line in loop.wrong())


def test_a_missed_step_that_was_not_saved_is_made_again(tmp_path: Path) -> None:
    """Killed after it was traced, the plant counts the transition before, and misses it again."""
    run = RecordedPair(tmp_path, b"hi")
    run.steps(40, {20: "offer lost"})
    run.stop()
    lines = read_lines(tmp_path / PLANT_TRACE)
    at = next(i for i, line in enumerate(lines) if line["event"] == "missed")
    unsaved = {**lines[at], "x_next": [0.0, 0.0]}
    back = [
        {"event": "continued"},
        next(line for line in lines if line["event"] == "session") | {"reason": RESUMED},
    ]
    lines[at:at] = [unsaved, *back, lines[at - 1]]
    write_lines(tmp_path / PLANT_TRACE, [line for line in lines if line["event"] != "end"])
    assert check(read_evidence(tmp_path)) == []


class Killed(Exception):
    pass


class Mortal(RecordedPair):
    """Whoever is killed stays dead."""

    def die(self, side: Name) -> None:
        self.kill(side)
        raise Killed


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", ["keys", "sealed"])
def test_a_run_that_a_kill_ends_before_its_last_step_is_traced_is_honest(
    tmp_path: Path, name: str, side: Side
) -> None:
    loop = Mortal(tmp_path, MESSAGES[0], name=name)
    loop.run(lambda: loop.plant.state.record.link.k >= 30)
    loop.crash_at(side, "tracing")
    with pytest.raises(Killed):
        loop.run(lambda: False)
    (other,) = loop.ends
    loop.kill(other)
    (killed,) = (t for t in read_evidence(tmp_path).ends() if t.side == side)
    assert killed.untraced is not None
    assert loop.wrong() == []
