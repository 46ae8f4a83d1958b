"""Two hundred packed candidates: more than a signed byte has, in engine, link and both ends."""

import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario
from protocol.schemes.framing import Deframer
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.network import Simulation


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
    runs = simulate_runs(scenario, law, seed=1, runs=range(2), steps=80)
    assert (runs.symbol == runs.coin).all()
    link = transfer(runs, payloads=[b"The old mill, at nine."])
    deframer = Deframer(200)
    found = [deframer.push(v) for v in link.message_symbol[:, 0].tolist() if v != NO_SYMBOL]
    assert [payload for payload in found if payload is not None] == [b"The old mill, at nine."]
    assert runs.coin.max() > 127
    history = Simulation(scenario, law, seed=1, payloads=(b"both ends",)).run(steps=60)
    assert history.inbox == [b"both ends"]
