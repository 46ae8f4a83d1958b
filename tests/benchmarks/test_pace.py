"""The benchmarks in real time: the shape and the arithmetic of their results, never their speed."""

import importlib
import math
from collections.abc import Callable
from inspect import signature
from pathlib import Path

import pytest

from benchmarks import fleet, pace
from benchmarks.__main__ import BENCHMARKS, main
from protocol.messages import LATENCY_BOUNDS_S

ROOT = Path(__file__).resolve().parents[2]


def test_a_quantile_is_the_upper_bound_of_its_bucket() -> None:
    counts = [0] * (len(LATENCY_BOUNDS_S) + 1)
    counts[0], counts[3], counts[-1] = 90, 9, 1
    assert fleet.quantile_ms(counts, 0.5) == 1e3 * LATENCY_BOUNDS_S[0]
    assert fleet.quantile_ms(counts, 0.99) == 1e3 * LATENCY_BOUNDS_S[3]
    assert math.isinf(fleet.quantile_ms(counts, 0.999))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["loop", "--loops", "3"], "--loops: is for the benchmark fleet"),
        (["fleet", "--loops", "0"], "--loops: got 0"),
        (["fleet", "--seconds", "0"], "--seconds: got 0"),
    ],
)
def test_options_of_the_fleets_benchmark(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(options) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", BENCHMARKS)
@pytest.mark.parametrize("machine", [False, True])
def test_what_goes_on_is_said_beside_the_result(
    name: str, machine: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``pace`` takes minutes: each rate is a line on standard error, with ``--json`` too."""
    module = importlib.import_module(BENCHMARKS[name].module)
    assert signature(module.measure).parameters["progress"].default is None

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
def test_a_small_fleet_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "SETTLE_S", 1.0)
    result = fleet.measure(loops=2, seconds=3.0)
    assert result["running"] == 2
    assert result["steps"] > 0
    assert 0 <= result["missed"] <= result["steps"]
    assert result["memory_mib"] == sum(result["memory"].values()) > 0
    assert result["p50_ms"] <= result["p99_ms"]
    assert result["tap_expected"] > 0
    assert "lost at the taps" in fleet.render(result)


@pytest.mark.long
@pytest.mark.integration
def test_a_pace_is_measured() -> None:
    result = pace.measure(steps=50, rates=(100,), shown={50: 20})
    assert result["highest_hz"] in (0, 100)
    held = [row for row in result["tried"] if row["missed"] == 0]  # none on a busy machine
    assert (result["highest_hz"] == 100) == bool(held)
    assert [row["rate_hz"] for row in result["latencies"]] == [50]
    assert "Hz" in pace.render(result)


@pytest.mark.long
@pytest.mark.integration
def test_a_rate_that_missed_a_step_is_not_run_to_its_end() -> None:
    row = pace.run_at(5000, 60_000, until_missed=True)
    assert row["missed"] > 0
    assert 0 < row["steps"] < 60_000


def test_what_the_taps_lack_is_no_offer_of_a_missed_step(tmp_path: Path) -> None:
    loop = tmp_path / "loop-0000"
    (loop / "tap").mkdir(parents=True)
    (loop / "plant").mkdir()
    seen = [("measurement", k) for k in (3, 4, 5, 6)] + [("offer", 3), ("offer", 6)]
    lines = (f'{{"event":"field","topic":"{topic}","message":{{"k":{k}}}}}\n' for topic, k in seen)
    (loop / "tap" / "capture.jsonl").write_text("".join(lines))
    (loop / "plant" / "trace.jsonl").write_text('{"event":"missed","session":"s","k":4,"x":[]}\n')
    assert fleet.lost(tmp_path) == (7, 1)
