"""The safety and liveness of the link, on a seeded faulty network with processes that die.

A failing seed is printed with its test and replays: everything random comes from it.
"""

import pytest

from controller_service.laws.base import CandidateLaw
from protocol.scenario import Scenario
from tests.support.safety import violations
from tests.support.size import size
from tests.support.watched import Watched
from wyner.simulate.faults import Faults

PAYLOADS = (b"first", b"second message", b"3")

NETWORKS = {
    "clean": Faults(),
    "loses": Faults(loss=0.4, until_s=60),
    "repeats": Faults(repeat=0.5, until_s=60),
    "reorders": Faults(delay_s=0.4, repeat=0.3, until_s=60),
    "crashes": Faults(crash=0.02, until_s=60),
    "forgets": Faults(crash=0.02, amnesia=0.5, until_s=60),
    "everything": Faults(0.2, 0.2, 0.15, 0.02, 0.2, until_s=60),
}


@pytest.mark.parametrize("step_s", [None, 0.1], ids=["lockstep", "deadlines"])
@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("seed", size([0], [0, 1]))
def test_safety_always_and_delivery_once_all_is_well(
    network: str, seed: int, step_s: float | None, sustained: Scenario, sustained_law: CandidateLaw
) -> None:
    faults = NETWORKS[network]
    sim = Watched(
        sustained, sustained_law, seed=seed, payloads=PAYLOADS, faults=faults, step_s=step_s
    )
    history = sim.run(seconds=900, until=lambda: len(sim.history.delivered) >= len(PAYLOADS))
    assert list(violations(history, PAYLOADS)) == []
    assert [history.delivered.index(i) for i in range(3)] == [0, 1, 2]
    if not faults.amnesia:
        assert history.inbox == list(PAYLOADS)
    if faults.crash:
        assert history.crashes > 0
    if faults.loss and step_s is not None:
        assert history.missed > 0
