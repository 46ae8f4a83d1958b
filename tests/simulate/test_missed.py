"""The network table: the same steps missed wherever it is passed, and as many as expected."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.scenario import Scenario, ScenarioError, parse_scenario
from protocol.statistics import Interval, share_over_runs
from runtime.errors import UsageError
from runtime.network import check_delays, round_trip_s
from runtime.shipped import SCENARIOS
from tests.support.recorded_pair import law_of
from wyner.api import design, run
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.missed import missed_steps
from wyner.simulate.network import Simulation

BURSTS = {"loss": 0.05, "loss_bad": 0.9, "to_bad": 0.05, "to_good": 0.3}
LATE = {"delay": "gamma", "delay_s": 0.05, "jitter_s": 0.04}
TABLES: dict[str, dict[str, Any]] = {
    "losses": {"to_plant": {"loss": 0.3}, "to_controller": {"loss": 0.3}},
    "bursts": {"to_plant": BURSTS},
    "jitter": {
        "to_plant": {"delay": "uniform", "delay_s": 0.04, "jitter_s": 0.03, "loss": 0.1},
        "to_controller": {"delay": "gamma", "delay_s": 0.03, "jitter_s": 0.02, "loss": 0.2},
    },
    "late and bursts": {"to_plant": LATE, "to_controller": LATE | BURSTS},
    "slow": {"to_plant": {"rate_hz": 40.0, "loss": 0.3}, "to_controller": {"rate_hz": 50.0}},
}


def networked(table: dict[str, Any], name: str = "sustained", **link: Any) -> Scenario:
    scenario, _ = law_of(name)
    data = scenario.model_dump(mode="json", exclude_none=True)
    data["network"] = table
    data["link"] |= link
    return parse_scenario(data, name)


def share(scenario: Scenario, runs: int = 20, steps: int = 600) -> Interval:
    """Counted over runs, seed 3."""
    missed = missed_steps(scenario, seed=3, runs=range(runs), steps=steps)
    assert missed is not None
    return share_over_runs([(int(m), steps) for m in missed.sum(axis=0)])


def test_losses_alone_are_the_product() -> None:
    """Four copies, each through with probability 0.49: 0.51^4 are missed."""
    for scenario, told in (
        (networked(TABLES["losses"]), 0.51**4),
        (networked(TABLES["losses"], repeats_per_period=1), 0.51),
    ):
        counted = share(scenario)
        assert abs(counted.value - told) <= 1.5 * counted.width
    assert missed_steps(law_of("sustained")[0], seed=3, runs=range(1), steps=9) is None


def test_a_round_trip_longer_than_a_step_misses_every_step() -> None:
    for delay, told in (({"delay_s": 0.051}, 1.0), ({"delay_s": 0.049}, 0.0)):
        assert share(networked({"to_plant": delay, "to_controller": delay})).value == told


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("fallback", ["hold", "zero", "regulator"])
def test_the_engine_misses_the_steps_that_the_two_ends_miss(name: str, fallback: str) -> None:
    """To the last bit: states, coins, verdicts and key symbols of every step, seed 5."""
    scenario = networked(TABLES[name], fallback=fallback)
    _, law = law_of("sustained")
    steps = 120
    together = simulate_runs(scenario, law, seed=5, runs=range(1), steps=steps, record=True)
    both = Simulation(scenario, law, seed=5, step_s=scenario.plant.period_s)
    history = both.run(steps=steps)
    assert together.missed is not None
    assert history.missed == together.missed.sum() > 0
    link = transfer(together)
    assert together.x is not None
    done = [t for t in history.plant.values() if t.k < steps]
    made = np.flatnonzero(~together.missed[:, 0]).tolist()
    assert [t.k for t in done] == made[: len(done)]
    assert len(made) - len(done) <= 1
    for t in done:
        assert t.x == tuple(together.x[t.k, :, 0])
        assert t.x_next == tuple(together.x[t.k + 1, :, 0])
        assert t.coin == together.coin[t.k, 0]
        assert t.symbol == link.agreed[t.k, 0]
        assert t.cipher == link.cipher[t.k, 0]


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"to_plant": {"jitter_s": 0.1}}, "expected delay = 'uniform' or 'gamma' with it"),
        ({"to_plant": {"delay": "uniform", "jitter_s": 0.1}}, "expected at most delay_s, 0"),
        ({"to_plant": {"delay": "gamma", "delay_s": 0.1}}, "expected both above 0"),
        (
            {"to_plant": {"delay": "gamma", "delay_s": 0.03, "jitter_s": 1e-300}},
            "got 1e-300, expected from delay_s / 1000 to 1000 delay_s, 0.03",
        ),
        (
            {"to_plant": {"delay": "gamma", "delay_s": 1e-300, "jitter_s": 1.0}},
            "got 1, expected from delay_s / 1000 to 1000 delay_s, 1e-300",
        ),
        ({"to_plant": {"delay": "measured"}}, "expected one where delay is 'measured'"),
        ({"to_plant": {"to_bad": 0.1}}, "expected loss_bad too"),
        ({"to_plant": BURSTS | {"to_good": 0.99}}, "expected to_bad above 0 and a sum"),
        ({"to_controller": {"rate_hz": 10.0}}, "expected at least 40: 4 messages in 0.1 s"),
    ],
)
def test_a_wrong_table_is_one_line(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says) as refused:
        networked(table)
    assert len(refused.value.problems) == 1


def test_measured_delays_come_from_their_file(tmp_path: Path) -> None:
    table = {"delay": "measured", "file": "delays.txt"}
    scenario = networked({"to_plant": table}, repeats_per_period=1)
    file = tmp_path / "delays.txt"
    file.write_text("0.02\n0.03\n0.15\n0.25\n")
    missed = missed_steps(scenario, seed=1, runs=range(10), steps=400, folder=tmp_path)
    assert missed is not None
    assert missed.mean() == pytest.approx(0.5, abs=0.03)
    bom = "\ufeff0.02\r\n0.03\r\n0.15\r\n1e9\r\n"
    file.write_bytes(bom.encode())
    late = missed_steps(scenario, seed=1, runs=range(10), steps=400, folder=tmp_path)
    assert late is not None
    assert late.mean() == pytest.approx(0.5, abs=0.03), "as another program wrote it, one huge"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "cannot be read: No such file or directory"),
        (b"", "got 0 delays, expected 1 to 1000000 delays"),
        (b"0.1\n-0.02\n", "delay 2: got -0.02, expected seconds, 0 or more"),
        (b"0.1\nnan\n", "delay 2: got nan, expected"),
        (b"1e400\n", "delay 1: got 1e400, expected"),
        (b"delay_s\n0.1\n", "delay 1: got delay_s, expected"),
        (b"0.1, 0.2\n", "delay 1: got 0.1,, expected"),
        (b"7" * 10_000, "delay 1: got 7{40}[.]{3}, expected"),
        (b"\xff\xfe", "cannot be read: not UTF-8 text"),
        (b"0 " * 1_000_001, "got 1000001 delays, expected 1 to 1000000"),
    ],
)
def test_a_wrong_file_of_delays_is_one_line(
    content: bytes | None, says: str, tmp_path: Path
) -> None:
    scenario = networked({"to_plant": {"delay": "measured", "file": "delays.txt"}})
    if content is not None:
        (tmp_path / "delays.txt").write_bytes(content)
    with pytest.raises(UsageError, match=f"^network: .*delays.txt: {says}") as refused:
        check_delays(scenario, tmp_path)
    assert len(refused.value.lines) == 1


def test_a_run_looks_for_the_delays_beside_its_scenario(tmp_path: Path) -> None:
    (tmp_path / "delays.txt").write_text("0.02\n0.03\n0.25\n")
    text = (SCENARIOS / "sustained.toml").read_text()
    way = '[network.to_plant]\ndelay = "measured"\nfile = "delays.txt"\n'
    file = tmp_path / "traced.toml"
    file.write_text(f"{text}\n{way}")
    system = design(file)
    expected = missed_steps(system.scenario, seed=4, runs=range(2), steps=80, folder=tmp_path)
    assert expected is not None
    assert expected.any()
    for found in (run(system, steps=80, runs=2, seed=4), run(str(file), steps=80, runs=2, seed=4)):
        assert found.missed_share == pytest.approx(expected.mean(axis=0))


def test_the_plant_waits_at_its_end_for_forty_periods_at_most() -> None:
    """A way of an hour, and a run of 40 steps never ended."""
    assert round_trip_s(networked({"to_plant": {"delay_s": 3600.0}}), Path()) == pytest.approx(4.0)
    assert round_trip_s(networked({"to_plant": {"delay_s": 0.2}}), Path()) == pytest.approx(0.2)
