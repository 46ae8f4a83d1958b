"""What an attack came to: over sessions that begin anew, and from traces that are damaged."""

from pathlib import Path
from typing import Any

from runtime.run_folder import CONTROLLER_TRACE
from tests.support.traced import at_controller, met, session, transition, write_run
from wyner.runs.run import Run
from wyner.runs.score.attacked import attack_lines, attacked

Line = dict[str, Any]

A, B = "a" * 16, "f" * 16
ONSET = 5


def began(at: str = "sensor") -> Line:
    told = {"event": "attack", "kind": "ghost", "at": at, "onset": ONSET}
    return told | {"knows": [], "options": {}}


def step(name: str, j: int, k: int, away: float) -> Line:
    said, true = [0.0, 1.0], [away, 1.0]
    return transition(name, j, k, x_next=said, true_x_next=true, true_u=[0.0])


def alarm(name: str, k: int) -> Line:
    said = {"event": "alarm", "session": name, "j": k, "k": k, "reading": [0.0, 1.0]}
    said |= {"reason": "unexplained", "candidate": 0, "expected": [0.0, 0.0], "gauge": 2.0}
    return said


def write(run_dir: Path, plant: list[Line], controller: list[Line]) -> Run:
    return write_run(run_dir, "sustained", plant=plant, controller=controller)


def test_a_session_that_begins_anew_overwrites_no_step_of_the_one_before(tmp_path: Path) -> None:
    """Distances were kept by step alone: the second session's took the place of the first's."""
    first = [step(A, k, k, float(k)) for k in range(20)]
    second = [step(B, k, k, 0.25) for k in range(10)]
    plant = [session(A), began(), *first, session(B), *second]
    run = write(tmp_path, plant, [alarm(A, 8)])
    found = attacked(run)
    assert found is not None
    assert (found["alarm_k"], found["delay"]) == (9, 5)
    assert found["away_at_alarm"] == 8.0
    assert found["away_most"] == 19.0
    assert found["away"] == 0.25
    assert found["false_alarms"] == 0
    # an alarm in the second session comes twenty steps later, at a step that the first had too
    run = write(tmp_path / "later", plant, [alarm(B, 2)])
    found = attacked(run)
    assert found is not None
    assert (found["alarm_k"], found["delay"], found["away_at_alarm"]) == (3, 19, 0.25)


def test_of_an_attack_on_the_bus_what_was_sent_is_compared_with_what_came(tmp_path: Path) -> None:
    plant = [
        line
        for s in (A, B)
        for line in (session(s), *(transition(s, k, k, x_next=[float(k), 0.0]) for k in range(12)))
    ]
    shown = [
        at_controller(line, x_next=[0.0, 0.0], expected=1)
        if line["event"] == "transition"
        else met(line["session"])
        for line in plant
    ]
    found = attacked(write(tmp_path, [plant[0], began("bus"), *plant[1:]], shown))
    assert found is not None
    assert (found["away"], found["away_most"], found["shown"]) == (11.0, 11.0, 0.0)
    assert (found["watched"], found["unwatched"]) == (24 - ONSET + 1, 0)


def test_a_damaged_trace_is_no_proof_that_there_was_no_alarm(tmp_path: Path) -> None:
    """It was left out without a word, and the run said "no alarm"."""
    plant = [session(A), began(), *(step(A, k, k, 1.0) for k in range(20))]
    run = write(tmp_path, plant, [alarm(A, 8)])
    path = tmp_path / CONTROLLER_TRACE
    head = path.read_bytes().splitlines(keepends=True)[0]
    for content in (head + b'{"event":"alarm"}\n', None):
        if content is None:
            path.unlink()
        else:
            path.write_bytes(content)
        found = attacked(run)
        assert found is not None
        assert found["alarm_k"] == -1
        (why,) = found["unread"]
        assert str(CONTROLLER_TRACE) in why
        text = "\n".join(attack_lines(found))
        assert "alarm or not is unknown" in text
        assert "no alarm" not in text
        assert f"WARNING: counted up to there: {why}" in text
