"""Guarded messages between the simulated ends, and an end whose keys come late."""

from itertools import pairwise
from typing import Any

import pytest

from protocol.agreement import NO_SYMBOL
from protocol.link.events import Event, Forged
from protocol.link.guarded import Guarded
from protocol.link.session import CountedTransition
from protocol.scenario import Scenario, parse_scenario
from protocol.secret.tasks import Task
from tests.support.once import Slots
from tests.support.safety import violations
from tests.support.small_run import law_of
from wyner.simulate.network import Side, Simulation

PERIOD_S = 0.1
LATE_S = 2.0


def guarded(messages: str) -> Scenario:
    """The shipped scenario ``keys`` with its messages guarded."""
    data = law_of("keys")[0].model_dump(mode="json", exclude_none=True, exclude_unset=True)
    return parse_scenario(data | {"defence": {"messages": messages}}, "guarded")


class Late(Simulation):
    """Each task of one end's keys is done so many seconds later; when each step was made."""

    def __init__(self, scenario: Scenario, late: Side | None, late_s: float, **more: Any) -> None:
        self._late, self._late_s = late, late_s
        self.made_s: list[float] = []
        self.slots = Slots()
        super().__init__(scenario, law_of("keys")[1], seed=1, step_s=PERIOD_S, **more)

    def keep(self, side: Side, task: Task) -> None:
        if side != self._late:
            super().keep(side, task)
        else:
            self.after(self._late_s, lambda: super(Late, self).keep(side, task))

    def send(self, to: Side, message: Any) -> None:
        self.slots.left(type(message), message.wire())
        super().send(to, message)

    def traced(self, event: Event) -> None:
        super().traced(event)
        assert not isinstance(event, Forged), "an honest message was refused"
        if isinstance(event, CountedTransition) and event.coin != NO_SYMBOL:
            self.made_s.append(self.now_s)

    @property
    def longest_s(self) -> float:
        """The longest time between two steps."""
        return max(b - a for a, b in pairwise(self.made_s))


@pytest.mark.parametrize("messages", ["mac", "coding"])
def test_a_guarded_scenario_is_guarded_in_a_simulation(messages: str) -> None:
    """600 steps, seed 1: each is made in time, and the message arrives."""
    both = Late(guarded(messages), None, 0.0, payloads=(b"a",))
    history = both.run(steps=600)
    assert list(violations(history, (b"a",))) == []
    assert history.inbox == [b"a"]
    assert history.missed == 0
    controller = both.ends["controller"].endpoint
    assert isinstance(controller, Guarded)
    assert controller.status().guarded > 200
    assert len(both.slots.served) > 200


@pytest.mark.parametrize("late", ["plant", "controller"])
def test_an_end_whose_keys_come_late_holds_the_loop_up_for_no_longer(late: Side) -> None:
    """It looks a batch up when a message names it; 900 steps, each of its tasks late by 2 s."""
    both = Late(guarded("mac"), late, LATE_S)
    both.run(steps=900, seconds=200.0)
    assert both.k >= 900
    assert 2 * PERIOD_S < both.longest_s < LATE_S + 2 * PERIOD_S
    assert both.history.record is not None
    assert both.history.record.sessions == 1
    assert len(both.slots.served) > 200
