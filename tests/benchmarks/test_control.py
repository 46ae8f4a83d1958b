"""The benchmark of the sets: the shape and consistency of its results, no speed."""

import json
import statistics
import sys

import pytest

from benchmarks import sets
from benchmarks.__main__ import main

pytestmark = pytest.mark.long


def test_the_package_makes_our_sets_and_is_measured_beside_us() -> None:
    pytest.importorskip("polytope")
    result = sets.measure(horizon=12, rounds=2)
    assert result["relative_error"] < sets.RIGHT
    assert result["ratio"] == statistics.median(result["ratios"]) > 1
    assert 0 < result["ratio_with_terminal_set"] < result["ratio"]
    assert 0 < result["seconds"] < result["package_seconds"]
    assert json.loads(json.dumps(result)) == result
    assert f"ratio {result['ratio']:.0f}, " in sets.render(result)
    wrong = result | {"relative_error": 0.1}
    assert "its last set is WRONG" in sets.render(wrong)


def test_without_the_package_it_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "polytope", None)
    assert main(["sets"]) == 2
    assert "polytope" in capsys.readouterr().err
