"""The engine's benchmark: the shape and the arithmetic of its result, never its speed."""

import json
from typing import Any

import pytest

from benchmarks import engine as bench_engine
from benchmarks.__main__ import main
from benchmarks.engine import measure, render

pytestmark = pytest.mark.long

QUICK: dict[str, Any] = {"rounds": 2, "runs": 40, "steps": 20, "core_steps": 40}


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    return measure(**QUICK)


def test_the_ratio_is_that_of_the_rates(result: dict[str, Any]) -> None:
    assert result["ratio"] == result["steps_per_second"] / result["cores_steps_per_second"] > 0
    low, high = result["spread"]
    assert 0 < low <= result["steps_per_second"] <= high
    assert (result["rounds"], result["runs"], result["steps"]) == (2, 40, 20)


def test_the_result_for_machines_and_for_people(
    result: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_engine, "measure", lambda **_: result)
    assert main(["engine", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result))
    text = render(result)
    assert f"ratio {result['ratio']:.0f} " in text
