"""The benchmarks: the shape and the arithmetic of their results, never their speed."""

import importlib
import json
import math
import statistics
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks import engine, fleet, loop, pace, sets
from benchmarks.__main__ import BENCHMARKS, main
from protocol.messages import LATENCY_BOUNDS_S
from protocol.scenario import ScenarioError
from runtime.errors import Failure


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["loop", "--loops", "3"], "--loops: is for the benchmark fleet"),
        (["fleet", "--loops", "0"], "--loops: got 0"),
        (["fleet", "--seconds", "0"], "--seconds: got 0"),
        (["sets"], "polytope"),
    ],
)
def test_what_cannot_be_measured_is_told(
    options: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A package that is not there among it."""
    monkeypatch.setitem(sys.modules, "polytope", None)
    assert main(options) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", BENCHMARKS)
@pytest.mark.parametrize("machine", [False, True])
def test_what_goes_on_is_said_beside_the_result(
    name: str, machine: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``pace`` takes minutes: each rate is a line on standard error, with ``--json`` too."""
    module = importlib.import_module(BENCHMARKS[name].module)

    def measure(progress: Callable[[str], None]) -> dict[str, float]:
        progress("20 Hz, 600 steps")
        return {"highest_hz": 20}

    monkeypatch.setattr(module, "measure", measure)
    monkeypatch.setattr(module, "render", lambda result: f"highest: {result['highest_hz']} Hz")
    assert main([name, *(["--json"] if machine else [])]) == 0
    said = capsys.readouterr()
    assert said.err == f"{name}: {BENCHMARKS[name].text} ...\n  20 Hz, 600 steps\n"
    assert said.out == ('{"highest_hz": 20}\n' if machine else "highest: 20 Hz\n")


@pytest.mark.long
@pytest.mark.integration
def test_the_loop_is_measured() -> None:
    """A tap that joins half a second late has still heard most of 800 steps."""
    said: list[str] = []
    result = loop.measure(rounds=2, steps=800, progress=said.append)
    assert len(said) == len(result["rounds"]) == 2
    assert result["steps_per_second"] == statistics.median(result["rounds"])
    assert result["spread"] == sorted(result["rounds"])
    assert min(result["rounds"]) > 0
    assert json.loads(json.dumps(result)) == result
    assert set(result["startup_s"]) == {"controller", "plant", "tap"}
    assert f"a second {result['steps_per_second']:.0f} " in loop.render(result)


def test_a_service_or_a_scenario_that_fails_the_loop_is_named(tmp_path: Path) -> None:
    with pytest.raises((Failure, ScenarioError), match=r"none\.toml"):
        loop.measure(rounds=1, steps=10, scenario=tmp_path / "none.toml")
    service = loop.ServiceProcess("plant", ["--pace", "backwards"])
    try:
        with pytest.raises(Failure, match=r"plant did not start: .*backwards"):
            service.wait_until_up()
    finally:
        service.stop()


@pytest.mark.long
def test_the_engine_is_measured_beside_the_cores() -> None:
    result = engine.measure(rounds=2, runs=40, steps=20, core_steps=40)
    assert result["ratio"] == result["steps_per_second"] / result["cores_steps_per_second"] > 0
    low, high = result["spread"]
    assert 0 < low <= result["steps_per_second"] <= high
    assert f"ratio {result['ratio']:.0f} " in engine.render(result)


@pytest.mark.long
def test_the_sets_are_those_of_the_package_which_is_measured_beside_ours() -> None:
    pytest.importorskip("polytope")
    result = sets.measure(horizon=12, rounds=2)
    assert result["relative_error"] < sets.RIGHT
    assert result["ratio"] == statistics.median(result["ratios"]) > 1
    assert 0 < result["ratio_with_terminal_set"] < result["ratio"]
    assert f"ratio {result['ratio']:.0f}, " in sets.render(result)
    wrong = result | {"relative_error": 0.1}
    assert "its last set is WRONG" in sets.render(wrong)


@pytest.mark.long
@pytest.mark.integration
def test_a_pace_is_measured_and_a_rate_that_missed_a_step_is_not_run_to_its_end() -> None:
    result = pace.measure(steps=50, rates=(100,), shown={50: 20})
    assert result["highest_hz"] in (0, 100)
    held = [row for row in result["tried"] if row["missed"] == 0]  # none on a busy machine
    assert (result["highest_hz"] == 100) == bool(held)
    assert [row["rate_hz"] for row in result["latencies"]] == [50]
    assert "Hz" in pace.render(result)
    row = pace.run_at(5000, 60_000, until_missed=True)
    assert row["missed"] > 0
    assert 0 < row["steps"] < 60_000


@pytest.mark.long
@pytest.mark.integration
def test_a_small_fleet_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "SETTLE_S", 1.0)
    result = fleet.measure(loops=2, seconds=3.0)
    assert result["running"] == 2
    assert 0 <= result["missed"] <= result["steps"] > 0
    assert result["memory_mib"] == sum(result["memory"].values()) > 0
    assert result["p50_ms"] <= result["p99_ms"]
    assert result["tap_expected"] > 0
    assert "lost at the taps" in fleet.render(result)


def test_a_quantile_is_the_upper_bound_of_its_bucket() -> None:
    counts = [0] * (len(LATENCY_BOUNDS_S) + 1)
    counts[0], counts[3], counts[-1] = 90, 9, 1
    assert fleet.quantile_ms(counts, 0.5) == 1e3 * LATENCY_BOUNDS_S[0]
    assert fleet.quantile_ms(counts, 0.99) == 1e3 * LATENCY_BOUNDS_S[3]
    assert math.isinf(fleet.quantile_ms(counts, 0.999))


def test_what_the_taps_lack_is_no_offer_of_a_missed_step(tmp_path: Path) -> None:
    one = tmp_path / "loop-0000"
    (one / "tap").mkdir(parents=True)
    (one / "plant").mkdir()
    seen = [("measurement", k) for k in (3, 4, 5, 6)] + [("offer", 3), ("offer", 6)]
    lines = (f'{{"event":"field","topic":"{topic}","message":{{"k":{k}}}}}\n' for topic, k in seen)
    (one / "tap" / "capture.jsonl").write_text("".join(lines))
    (one / "plant" / "trace.jsonl").write_text('{"event":"missed","session":"s","k":4,"x":[]}\n')
    assert fleet.lost(tmp_path) == (7, 1)
