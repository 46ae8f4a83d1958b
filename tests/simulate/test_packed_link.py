"""Packed and pipelined: the claimed rates, and that a tap without a threshold has it all."""

import math
from typing import Any

import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario
from protocol.schemes.framing import Deframer
from runtime.scenario_file import scenario_of
from tests.support.size import size
from wyner.simulate.engine import follow, simulate_runs, transfer
from wyner.simulate.network import Simulation

RUNS, STEPS = range(20), size(150, 500)
CORNERS = {"kind": "corners", "half_widths": (0.12, 0.12)}
"""Of D_c."""
SHIPPED = {
    "packed": 4,
    "packed-double-integrator": 4,
    "packed-quadruple-tank": 16,
    "packed-batch-reactor": 16,
}


def system(
    name: str, size: int, alpha: float, disturbance: dict[str, Any] | None = None
) -> tuple[Scenario, CandidateLaw]:
    scenario = scenario_of(name)
    secrecy = scenario.secrecy.model_copy(update={"candidates": size, "alpha": alpha})
    spec = scenario.plant.disturbance.model_copy(update=disturbance or {})
    plant = scenario.plant.model_copy(update={"disturbance": spec})
    scenario = scenario.model_copy(update={"secrecy": secrecy, "plant": plant})
    return scenario, make_law(scenario, cached_design(scenario))


def claimed_bits(scenario: Scenario, law: CandidateLaw) -> float:
    """Bits of agreed symbols a transition; every one of them is the applied candidate."""
    runs = simulate_runs(scenario, law, seed=1, runs=RUNS, steps=STEPS)
    link = follow(runs, [scenario.secrecy.alpha])
    assert link.mistaken.sum() == 0
    assert (link.message_symbols == STEPS - 1).all()
    share = float(link.agreements.sum()) / (len(RUNS) * STEPS)
    assert share >= 0.9999
    return share * math.log2(scenario.secrecy.candidates)


@pytest.mark.parametrize(
    ("alpha", "size", "bits"), [(3.01, 2, 1.0), (5.01, 3, 1.585), (7.01, 4, 2.0), (9.01, 5, 2.322)]
)
def test_bits_a_step_on_the_papers_plant(alpha: float, size: int, bits: float) -> None:
    assert claimed_bits(*system("packed", size, alpha)) == pytest.approx(bits, abs=5e-4)


@pytest.mark.parametrize("name", SHIPPED)
def test_bits_a_step_on_the_shipped_plants(name: str) -> None:
    size = SHIPPED[name]
    assert claimed_bits(*system(name, size, 8.0)) == pytest.approx(math.log2(size), abs=5e-4)


def test_at_odd_alphas_one_symbol_less() -> None:
    """alpha is compared sharply: at 3 exactly two candidates cannot both stay within alpha."""
    loop = system("packed", 2, 3.01, CORNERS)
    runs = simulate_runs(*loop, seed=1, runs=RUNS, steps=500)
    agreed = follow(runs, [3.0, 3.01]).agreements.sum(axis=1) / (len(RUNS) * 500)
    assert agreed.tolist() == [pytest.approx(0.5, abs=0.02), 1.0]


@pytest.mark.long
def test_two_hundred_candidates() -> None:
    scenario = Scenario.model_validate(
        {
            "name": "line",
            "plant": {
                "A": [[0.8]],
                "B": [[1.0]],
                "period_s": 0.1,
                "initial_state": [0.0],
                "disturbance": {"half_widths": [0.01]},
            },
            "defender": {"disturbance": {"half_widths": [0.01]}},
            "control": {"law": "packed", "horizon": 5, "inputs": {"half_widths": [5.0]}},
            "secrecy": {"alpha": 402.0, "candidates": 200, "scheme": "pipelined"},
        }
    )
    law = make_law(scenario, cached_design(scenario))
    assert claimed_bits(scenario, law) == pytest.approx(math.log2(200), abs=5e-4)
    runs = simulate_runs(scenario, law, seed=1, runs=range(2), steps=80)
    link = transfer(runs, payloads=[b"The old mill, at nine."])
    deframer = Deframer(200)
    found = [deframer.push(v) for v in link.message_symbol[:, 0].tolist() if v != NO_SYMBOL]
    assert [payload for payload in found if payload is not None] == [b"The old mill, at nine."]
    assert runs.coin.max() > 127
    history = Simulation(scenario, law, seed=1, payloads=(b"both ends",)).run(steps=60)
    assert history.inbox == [b"both ends"]
