"""The strongest tap's cost: a bound that does not hold fails the command."""

from typing import Any

import pytest

from benchmarks import text
from benchmarks.__main__ import main
from runtime.errors import DONE, FAILED


def measured(ms_a_step: float) -> dict[str, Any]:
    row = {"loss": 0.3, "seed": 4, "plant_had_it_at": 225, "she_had_it_at": None}
    rows = [{**row, "ms_a_step": ms_a_step}]
    return {"rows": rows, "steps": 320, "most_ms": text.MOST_MS, "held": ms_a_step <= text.MOST_MS}


@pytest.mark.parametrize(
    ("ms_a_step", "code", "word"), [(99.0, DONE, "held"), (101.0, FAILED, "NOT HELD")]
)
def test_a_bound_that_does_not_hold_fails(
    ms_a_step: float,
    code: int,
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(text, "measure", lambda progress: measured(ms_a_step))
    assert main(["text"]) == code
    assert capsys.readouterr().out.rstrip().endswith(f": {word}")


@pytest.mark.long
def test_a_short_run_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text, "SEEDS", (4,))
    monkeypatch.setattr(text, "LOSSES", (0.0,))
    said: list[str] = []
    found = text.measure(said.append)
    (row,) = found["rows"]
    assert len(said) == 1
    assert row["ms_a_step"] > 0
    assert row["plant_had_it_at"] <= row["she_had_it_at"]
