"""The checks of keys: a right run passes, each thing that is wrong fails the one that says so."""

import json
from pathlib import Path

import pytest

from runtime.run_folder import CAPTURE, PLANT_TRACE
from tap_service.inference.miss_rate import ALL
from tests.support.checked_runs import failed
from tests.support.lines import unmark
from tests.support.recorded_pair import Lines, edit
from tests.support.traces import events_of
from wyner.cli.main import main
from wyner.runs.run import Run
from wyner.runs.score.keys import KeyAudit, audit_keys
from wyner.runs.seal import evidence_below

pytestmark = [pytest.mark.slow, pytest.mark.integration]


def audit_of(folder: Path) -> KeyAudit:
    run = Run.load(folder)
    audit = audit_keys(run, run.scenario)
    assert audit is not None
    return audit


def test_a_run_that_makes_keys_passes_and_the_tap_holds_none(run: Path) -> None:
    assert failed(run) == set()
    audit = audit_of(run)
    assert audit.made >= 1
    assert audit.held_bits == 0
    assert audit.warnings == ()
    summary = json.loads((run / "summary.json").read_text())["keys"]
    assert summary["made"] == audit.made
    assert summary["refused"] is None


def test_every_file_that_a_run_leaves_is_evidence(run: Path) -> None:
    left = {path for path in run.rglob("*") if path.is_file()} - {*evidence_below(run)}
    none = {path for path in left if path.name in ("lock", "log.old") or path.name[0] == "."}
    assert left == none


def test_who_goes_for_the_keys_of_the_run_has_nothing_live_and_in_replay(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    audit = audit_of(run)
    live = json.loads((run / "tap" / "beliefs.json").read_text())["key-solver"]["keys"]
    again = ["score", str(run), "--eavesdropper", "key-solver", "--json"]
    assert main(again) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["taps"]["key-solver"]["keys"] == [live]
    exact = {(block.session, block.number): block for block in audit.blocks}
    assert live["newest"]  # how many there are by then is a matter of how fast the machine is
    for hers in live["newest"]:
        block = exact[hers["session"], hers["number"]]
        # a step that the plant missed, and she did not hear so, she takes for a transition: from
        # there on her blocks hold one that the true ones do not, with its two copies
        shifted = 2 * sum(
            before.steps - before.transitions
            for before in audit.blocks
            if before.session == block.session and before.number <= block.number
        )
        # what she takes for counted where she missed the word on it
        too_many = hers["counted"] - block.counted
        assert -shifted <= too_many <= 4 + shifted
        assert (hers["bits"], block.held_bits) == (0, 0)
        assert block.missed is not None
        fewer = max(too_many, 0) + shifted
        assert hers["rows"] - hers["missed"] >= block.rows - block.missed - fewer
    assert live["bits"] == 0
    assert main(["score", str(run)]) == 0
    out = capsys.readouterr().out
    holds = f"key-solver: holds 0 bits of 0 of {live['blocks']} key blocks"
    assert holds in out


def test_a_tap_that_heard_more_than_claimed_holds_bits_and_refutes_the_claim(copied: Path) -> None:
    """The capture as if she had missed nothing: all copies 0 of the run."""

    def hear_all(lines: Lines) -> None:
        example = next(line for line in lines if line["event"] == "field")
        for t in events_of(copied / PLANT_TRACE, "transition"):
            common = {"v": 4, "session": t["session"], "k": t["k"], "nonce": "", "copy_number": 0}
            common |= {"block": -1, "tag": ""}
            offer = common | {"candidates": t["candidates"], "cipher": 0, "heard": 0}
            read = {"x": t["x"], "applied_k": t["k"] - 1, "x_after": t["x"], "applied_copy": 0}
            for topic, message in (("measurement", common | read), ("offer", offer)):
                lines.append(example | {"topic": topic, "message": message})

    unmark(copied / CAPTURE)
    edit(copied / CAPTURE, hear_all)
    audit = audit_of(copied)
    assert audit.held_bits >= 256 * 2  # all rows of each block, the public one included
    assert {name for name, rate in audit.rates.items() if rate.refuted} == {
        "measurements", "offers", ALL,
    }  # fmt: skip
    assert len(audit.warnings) == 4
