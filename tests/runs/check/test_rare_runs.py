"""Runs that seldom happen, and pass; and what is said where one of them is wrong."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from controller_service.laws import registry
from controller_service.sets.design import SynthesisError
from protocol.agreement import NO_SYMBOL
from runtime.run_folder import CONTROLLER_JOURNAL, CONTROLLER_TRACE, PLANT_TRACE
from tests.support.checked_runs import failed
from tests.support.ended_run import ended_run
from tests.support.recorded_pair import Lines, RecordedPair, edit
from tests.support.traces import events_of
from wyner.runs import trace
from wyner.runs.check import bus, check, plant
from wyner.runs.check.evidence import EDGE, Finding, read_evidence
from wyner.runs.check.plant import unlike_manifest
from wyner.runs.lines import AttackLine


def wrong(folder: Path) -> dict[str, str]:
    return {finding.rule: finding.text for finding in reversed(check(read_evidence(folder)))}


def ended(run: RecordedPair, steps: int = 0) -> Path:
    run.steps(steps)
    run.stop()
    return run.folder


def test_a_plant_whose_journal_was_put_back_begins_a_new_session(tmp_path: Path) -> None:
    """The step that the copy holds is counted once more; a message comes after it."""
    run = RecordedPair(tmp_path / "run", b"hi")
    run.steps(40)
    run.step("journal copied")
    run.steps(20)
    run.step("journal put back")
    run.until_received(1)
    folder = ended(run, 3)
    assert wrong(folder) == {}
    plant, controller = read_evidence(folder).ends()
    assert plant.behind == 1
    assert len(plant.sessions) == len(controller.sessions) == 2


def test_a_first_step_that_is_missed_holds_the_input_zero(tmp_path: Path) -> None:
    held = (('fallback = "zero"', 'fallback = "hold"'),)
    run = RecordedPair(tmp_path / "run", b"hi", changes=held)
    run.step("offer lost")
    folder = ended(run, 20)
    assert wrong(folder) == {}


def test_a_disturbance_that_leaves_is_told_beside_the_largest_gauge(tmp_path: Path) -> None:
    """A key is then unlike the coin now and then, and both checks say how often."""
    wide = (('kind = "uniform"\n', 'kind = "gaussian"\ndeviation = 0.7\n'),)
    folder = ended(RecordedPair(tmp_path / "run", b"hi", changes=wide), 300)
    made = events_of(folder / PLANT_TRACE, "transition")
    left = [t for t in made if t["gauges"][t["coin"]] > 1 + EDGE]
    unlike = [t for t in left if t["symbol"] not in (NO_SYMBOL, t["coin"])]
    assert len(left) > len(unlike) > 0
    assert wrong(folder) == {}


def test_the_papers_law_is_held_to_its_gain_inside_the_terminal_set(tmp_path: Path) -> None:
    folder = ended(RecordedPair(tmp_path / "run", b"hi", name="paper"), 30)
    assert wrong(folder) == {}
    ((u,), same) = events_of(folder / PLANT_TRACE, "transition")[28]["candidates"]
    assert same == [u]

    def change(lines: Lines) -> None:
        made = [line for line in lines if line["event"] == "transition"]
        made[28].update(candidates=[[u], [u + 0.5]])

    for name in (PLANT_TRACE, CONTROLLER_TRACE):
        edit(folder / name, change)
    assert wrong(folder)["admissible"] == "candidate 1 is 0.5 away from K x inside T_0"


def test_a_scenario_for_which_there_are_no_sets_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(_scenario: object) -> None:
        raise SynthesisError("no terminal set")

    folder = ended(RecordedPair(tmp_path / "run", b"hi"), 5)
    monkeypatch.setattr(registry, "cached_design", none)
    assert wrong(folder) == {"admissible": "no terminal set"}
    assert check(read_evidence(folder)) == [Finding("admissible", "", -1, "no terminal set")]


def test_a_run_is_judged_the_same_in_smaller_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = ended_run(tmp_path / "run", (b"a", b"b")).folder
    for at_once in (4096, 20, 1):
        for module in (trace, bus, plant):
            monkeypatch.setattr(module, "AT_ONCE", at_once)
        assert check(read_evidence(folder)) == []
        (one, *_), _ = (list(end.chunks()) for end in read_evidence(folder).ends())
        assert len(one) <= at_once


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_message_that_is_gone_from_the_controllers_queue_is_missed(
    tmp_path: Path, number: int
) -> None:
    """The first was delivered; of the two that wait one is taken away, also the last."""
    ended_run(tmp_path, (b"hi", b"later", b"last"))
    assert failed(tmp_path) == set()
    with closing(sqlite3.connect(tmp_path / CONTROLLER_JOURNAL)) as db, db:
        db.execute("DELETE FROM outbox WHERE number = ?", (number,))
    found = failed(tmp_path)
    assert found == ({"whole"} if number == 1 else {"messages"} if number == 2 else set())


def test_an_attack_that_is_told_otherwise_than_the_manifest_has_it_is_seen() -> None:
    attack = AttackLine("ghost", "sensor", 5, ("bus",), {"share": 0.5})
    said = attack._asdict() | {"knows": ["bus"]}
    assert unlike_manifest(attack, said) == ""
    others: tuple[dict[str, Any], ...] = ({"onset": 6}, {"knows": []}, {"options": {"share": 0.25}})
    for other in others:
        assert "the manifest" in unlike_manifest(attack, said | other)
