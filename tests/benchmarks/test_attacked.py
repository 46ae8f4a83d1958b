"""The benchmark of attacked steps: the shape and the arithmetic of its result, never its speed."""

import json
from typing import Any

import pytest

from benchmarks import attacked
from benchmarks.__main__ import main

pytestmark = pytest.mark.slow


def test_both_ways_attack_the_same_loop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result: dict[str, Any] = attacked.measure(rounds=2, runs=40, steps=30, scalar_steps=40)
    assert result["unseen"] == 40  # who has the key is never seen, together or alone
    assert result["alarms"] == 0
    assert result["ratio"] == result["steps_per_second"] / result["scalar_steps_per_second"] > 0
    low, high = result["spread"]
    assert 0 < low <= result["steps_per_second"] <= high
    monkeypatch.setattr(attacked, "measure", lambda **_: result)
    assert main(["attacked", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result))
    assert "target 1e+06: missed" in attacked.render({**result, "steps_per_second": 9e5})
    assert "target 1e+06: met" in attacked.render({**result, "steps_per_second": 1e6})
