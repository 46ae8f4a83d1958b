"""A pendulum whose link dies for 300 steps: up under its own regulator, down under the others."""

from collections.abc import Callable

import pytest

from controller_service.sets.dead_link import dead_link_budget
from protocol.convex import Polytope
from protocol.messages import Message, Offer
from wyner.api import design, vary
from wyner.simulate.network import Simulation

DEAD = (20.0, 50.0)
"""Seconds without a single offer: 300 steps of 0.1 s."""


class DeadLink(Simulation):
    """A network that loses every offer while the link is dead."""

    def send(self, to: object, message: Message) -> None:
        if not (isinstance(message, Offer) and DEAD[0] <= self.now_s < DEAD[1]):
            super().send(to, message)  # type: ignore[arg-type]


def excursion(fallback: str, seconds: float) -> tuple[float, DeadLink, Callable[[], bool]]:
    """The farthest that the state came from T_N, in units of a facet; the simulation."""
    system = design(vary(design("pendulum").scenario, {"link.fallback": fallback}))
    largest = Polytope(*system.design.set(system.horizon))
    world = DeadLink(system.scenario, system.law, seed=3, payloads=(b"up", b"again"), step_s=0.1)
    worst = [-1.0]

    def look() -> bool:
        worst[0] = max(worst[0], largest.excess(world.plant.state.record.link.x))
        return worst[0] > 0.5

    world.run(seconds=seconds, until=look)
    return worst[0], world, look


def test_the_regulator_keeps_it_up_and_the_link_goes_on() -> None:
    worst, world, _ = excursion("regulator", 90.0)
    assert worst <= 0.0
    assert world.history.missed >= 299
    assert world.history.inbox == [b"up", b"again"]
    transitions = [t for t in world.history.plant.values() if t.k > 520]
    assert len(transitions) > 300


@pytest.mark.parametrize("fallback", ["hold", "zero"])
def test_without_it_the_pendulum_falls_no_sooner_than_its_budget(fallback: str) -> None:
    worst, world, _ = excursion(fallback, 60.0)
    assert worst > 0.0
    system = design(vary(design("pendulum").scenario, {"link.fallback": fallback}))
    budget = dead_link_budget(system.scenario, system.design)
    assert budget is not None
    assert world.history.missed > budget
    assert world.now_s < 30.0
