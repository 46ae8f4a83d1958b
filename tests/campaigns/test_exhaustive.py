"""A short form of the exhaustive exploration, and rules that it finds broken."""

from typing import Any

import pytest

from protocol.link.endpoint import Actions, Endpoint
from protocol.link.perform import Ports
from protocol.link.receiver import Receiver
from protocol.link.sender import Sender
from tests.campaigns import world
from tests.campaigns.exhaustive import Exploration, shortest
from tests.campaigns.world import SCHEMES


@pytest.mark.parametrize("scheme", SCHEMES)
def test_nothing_breaks_within_a_few_events(scheme: str) -> None:
    found = Exploration(scheme, depth=6, deaths=2, going_on=40)
    assert found.run(), (found.why, [str(doing) for doing in found.path])
    assert len(found.seen) > 500
    assert found.went_on > 10


def redecide(patch: pytest.MonkeyPatch) -> None:
    """Rule 3: a step that is counted again decides its symbol again."""
    decide = Sender._decide

    def anew(self: Sender, *args: Any, **kwargs: Any) -> Any:
        return decide(self, *args[:4])

    patch.setattr(Sender, "_decide", anew)


def apply_stale(patch: pytest.MonkeyPatch) -> None:
    """Rule 5: an offer for a step gone by is applied."""
    check = Receiver.check

    def anything(self: Receiver, offer: Any) -> Any:
        return "current" if check(self, offer) != "foreign" else "foreign"

    patch.setattr(Receiver, "check", anything)


def publish_first(patch: pytest.MonkeyPatch) -> None:
    """The shell publishes before it saves."""

    def perform(actions: Actions, endpoint: Endpoint, ports: Ports) -> None:
        while True:
            for kind, payload in actions.publish:
                ports.publish(kind, payload)
            for event in actions.events:
                ports.trace(event)
            if actions.write is not None:
                ports.write(actions.write)
            if not actions.settle:
                return
            actions = endpoint.settle()

    patch.setattr(world, "perform", perform)


def take_up_anything(patch: pytest.MonkeyPatch) -> None:
    """Rule 6: a controller that lost its journal goes on in the plant's session."""
    end = Sender._end_session

    def adopt(self: Sender, hello: Any, why: str) -> Any:
        if hello.session == self.record.session:
            return end(self, hello, why)
        self._adopt(hello)
        effects = end(self, hello, why)
        return effects._replace(save=True, reply=self._hello("accepted", hello), refusal="")

    patch.setattr(Sender, "_end_session", adopt)


@pytest.mark.parametrize("mutant", [redecide, apply_stale, publish_first, take_up_anything])
def test_a_broken_rule_is_found_with_a_shortest_counterexample(
    mutant: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    mutant(monkeypatch)
    found = shortest("switched", deepest=9, deaths=1, going_on=20, step_s=0.1, warm=True)
    assert found.why
    assert 0 < len(found.path) <= 9
