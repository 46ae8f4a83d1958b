"""The network table: the same steps missed wherever it is passed, and as many as expected."""

from typing import Any

import pytest

from protocol.link.channel import round_trip_s
from protocol.scenario import Scenario, ScenarioError
from protocol.statistics import Interval, share_over_runs
from tests.simulate.beside import beside_the_engine
from tests.support.recorded_pair import law_of
from tests.support.scenarios import changed
from wyner.simulate.missed import missed_steps

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
}


def share(scenario: Scenario, runs: int = 20, steps: int = 600) -> Interval:
    """Counted over runs, seed 3."""
    missed = missed_steps(scenario, seed=3, runs=range(runs), steps=steps)
    assert missed is not None
    return share_over_runs([(int(m), steps) for m in missed.sum(axis=0)])


def test_losses_alone_are_the_product() -> None:
    """Four copies, each through with probability 0.49: 0.51^4 are missed."""
    for scenario, told in (
        (changed("sustained", network=TABLES["losses"]), 0.51**4),
        (changed("sustained", network=TABLES["losses"], link={"repeats_per_period": 1}), 0.51),
    ):
        counted = share(scenario)
        assert abs(counted.value - told) <= 1.5 * counted.width
    assert missed_steps(law_of("sustained")[0], seed=3, runs=range(1), steps=9) is None


def test_a_round_trip_longer_than_a_step_misses_every_step() -> None:
    for delay, told in (({"delay_s": 0.051}, 1.0), ({"delay_s": 0.049}, 0.0)):
        both = {"to_plant": delay, "to_controller": delay}
        assert share(changed("sustained", network=both)).value == told


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("fallback", ["hold", "zero", "regulator"])
def test_the_engine_misses_the_steps_that_the_two_ends_miss(name: str, fallback: str) -> None:
    """To the last bit: every number of every step."""
    scenario = changed("sustained", network=TABLES[name], link={"fallback": fallback})
    _, law = law_of("sustained")
    done = beside_the_engine(scenario, law, 120, seed=5, run=0)
    assert 0 < len(done) < 120


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
        ({"to_plant": {"to_bad": 0.1}}, "expected loss_bad too"),
        ({"to_plant": BURSTS | {"to_good": 0.99}}, "expected to_bad above 0 and a sum"),
    ],
)
def test_a_wrong_table_is_one_line(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says) as refused:
        changed("sustained", network=table)
    assert len(refused.value.problems) == 1


def test_the_plant_waits_at_its_end_for_forty_periods_at_most() -> None:
    """A way of an hour, and a run of 40 steps never ended."""
    for delay_s, told in ((3600.0, 4.0), (0.2, 0.2)):
        scenario = changed("sustained", network={"to_plant": {"delay_s": delay_s}})
        assert round_trip_s(scenario) == pytest.approx(told)
