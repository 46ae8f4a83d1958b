"""The studies of noisy sensors: small ones, and what their recorded data say."""

import csv
from pathlib import Path

import numpy as np
import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.messages import Offer
from studies import DATA, corners, missed_steps, network, outputs
from studies.__main__ import main
from tap_service.capture.transcript import Transcript
from tools.reproduce import same
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import public_messages


def recorded(name: str) -> list[dict[str, str]]:
    with (DATA / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_corners_are_those_of_what_both_ends_assume(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small one, measured now: 4 runs of 100 steps."""
    for name, value in (("RUNS", 4), ("AT_ONCE", 2), ("STEPS", 100)):
        monkeypatch.setattr(corners, name, value)
    made = (row for name in corners.noisy_scenarios() for row in corners.corner_rows(name))
    rows = {row[0]: dict(zip(corners.COLUMNS.split(), row, strict=True)) for row in made}
    assert rows.keys() == {"encoder", "noisy"}
    for name, row in rows.items():
        assert row["wrong"] == 0
        assert row["agreed"] > 0.9
        scenario = corners.at_the_corners(name)
        assert scenario.plant.noise is not None
        assert scenario.defender.noise is not None
        assert scenario.plant.noise.half_widths == scenario.defender.noise.half_widths


def test_a_plant_that_misses_steps_measured_now() -> None:
    """One run: the engine's steps without an offer, some of which she takes for possible."""
    condition, _ = missed_steps.CONDITIONS
    scenario = missed_steps.scenario_of(condition)
    runs = simulate_runs(
        scenario, make_law(scenario, cached_design(scenario)), seed=1, runs=range(1), steps=60,
        record=True,
    )  # fmt: skip
    assert runs.missed is not None
    link = transfer(runs, payloads=[b"Hi"])
    said = list(public_messages(runs, link, 0, "0" * 16))
    offered = {m.k for m in said if isinstance(m, Offer)}
    assert {k for k in range(60) if k not in offered} == set(np.flatnonzero(runs.missed[:, 0]))
    assert 0 < runs.missed.sum() < 10
    heard = Transcript()
    transitions = [t for m in said for t in heard.hear(m)] + heard.flush()
    assert [t.k for t in transitions] == sorted(offered)  # who hears all is told of each


@pytest.mark.long
def test_a_row_of_each_listener_measured_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small one: 1 run of 60 steps, the lightest listeners."""
    for name, value in (("RUNS", 1), ("STEPS", 60), ("TAPS", ("set-membership", "text"))):
        monkeypatch.setattr(outputs, name, value)
    made = (row for c in outputs.CONDITIONS for row in outputs.output_rows(c))
    rows = [dict(zip(outputs.COLUMNS.split(), row, strict=True)) for row in made]
    assert [(row["condition"], row["tap"]) for row in rows] == [
        (condition, tap) for condition in outputs.CONDITIONS for tap in outputs.TAPS
    ]
    for row in rows:
        assert 0 <= row["later_low"] <= row["later"] / row["keys_of"] <= row["later_high"] <= 1
        if row["tap"] == "text" and row["condition"] == "clear":
            assert row["later"] > 0.9 * row["keys_of"]


@pytest.mark.long
def test_a_point_of_the_network_measured_now_is_the_one_on_record() -> None:
    """Losses of 0.4 each way: cost, rate and missed steps under the three fallbacks."""
    now = [
        dict(zip(network.COLUMNS.split(), map(str, row), strict=True))
        for row in network.network_rows(("loss", 0.4, 102))
    ]
    there = [row for row in recorded("network") if (row["part"], row["value"]) == ("loss", "0.4")]
    assert len(now) == len(there) == 3
    for mine, theirs in zip(now, there, strict=True):
        for name in network.COLUMNS.split():
            assert same(mine[name], theirs[name]), name


def test_data_are_measured_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "nothing", "--data", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("wyner: name: got 'nothing'")
