"""Nothing that a run recorded can be otherwise without a check that says so."""

import shutil
from pathlib import Path

import pytest

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE, SCENARIO
from tests.runs.check.mutants import Mutant, failed_by, mutants_of
from tests.support.checked_runs import failed
from tests.support.recorded_pair import read_lines, write_lines
from tests.support.size import size
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

pytestmark = pytest.mark.slow

STRIDE = size(11, 1)
"""One mutant in so many is tried."""


@pytest.fixture
def folder(killed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(killed, tmp_path / "run"))


def only_marked(m: Mutant) -> bool:
    """What nothing else recorded depends on: the end mark's digest alone protects it."""
    if (m.kind, m.how) == ("sent", "swapped"):
        return True  # with what came before anything was sent
    if m.kind == "header":
        if m.field in ("loop", "eavesdroppers", "appearances", "wyner_version"):
            return m.file == CAPTURE and m.how in ("small", "large", "huge", "shorter")
        return m.how == "deleted" and m.field in ("part", "oldest")  # 0 without them
    if m.kind == "continued":
        return m.field == "unheard_of" or (m.field, m.how) == ("", "repeated")
    if m.kind == "timing" and m.field != "event":
        # measured by a clock, once: other numbers are as good, of whatever count
        numbers = m.field.endswith("_s") and m.how == "shorter"
        return not m.field or numbers or m.how in ("small", "large", "huge")
    if m.file == CAPTURE:
        # a network repeats and reorders
        return m.field == "t_ns" or m.how in ("repeated", "swapped")
    return False


def test_honest_runs_pass(ended: Path, killed: Path) -> None:
    for folder in (ended, killed):
        assert check(read_evidence(folder)) == []


@pytest.mark.long
def test_every_change_of_meaning_fails_a_check(killed: Path, folder: Path) -> None:
    mutants = [m for m in mutants_of(killed) if not only_marked(m)]
    assert len(mutants) > 500
    survivors = [m.name for m in mutants[::STRIDE] if not failed_by(m, folder)]
    assert not survivors, "\n".join(survivors)


def test_an_end_mark_protects_the_rest(ended: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(ended, tmp_path / "marked"))
    marked = [m for m in mutants_of(ended) if only_marked(m)]
    captured = [m for m in marked if m.file == CAPTURE]
    measured = [m for m in marked if m.kind == "timing"]
    assert len(captured) >= 9
    assert len(measured) >= 18
    for m in (*captured[::STRIDE], *measured[::STRIDE]):
        assert "whole" in failed_by(m, folder), m.name


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("alpha = 8.0", "alpha = 7.9"),
        ("period_s = 0.1", "period_s = 0.2"),
        ('kind = "uniform"', 'kind = "corners"'),
    ],
)
def test_a_scenario_changed_after_the_run_fails(folder: Path, old: str, new: str) -> None:
    text = (folder / SCENARIO).read_text()
    assert old in text
    (folder / SCENARIO).write_text(text.replace(old, new))
    assert "whole" in failed(folder)


def test_files_cut_together_fail(folder: Path) -> None:
    """All three recordings end at the same step, as if nothing had come after it."""
    for name in (PLANT_TRACE, CONTROLLER_TRACE, CAPTURE):
        lines = read_lines(folder / name)
        at = next(
            i for i, line in enumerate(lines) if line.get("message", line).get("k", -1) == 100
        )
        write_lines(folder / name, lines[:at])
    assert "whole" in failed(folder)


def test_a_gauge_a_millionth_beyond_its_bound_fails(folder: Path) -> None:
    """The tolerance is rounding's, and no more."""
    lines = read_lines(folder / PLANT_TRACE)
    scenario = read_evidence(folder).scenario
    widths = scenario.defender.disturbance.rows()[1][::2]
    t = next(t for t in lines if t["event"] == "transition" and t["j"] == 40)
    centre = [
        sum(a * x for a, x in zip(row, t["x"], strict=True)) + b[0] * t["u"][0]
        for row, b in zip(scenario.A, scenario.B, strict=True)
    ]
    t["x_next"] = [c + w * (1 + 1e-6) for c, w in zip(centre, widths, strict=True)]
    write_lines(folder / PLANT_TRACE, lines)
    assert "plant" in failed(folder)
