"""A simulation that is looked at: all that both ends say, and all that they trace."""

from typing import Any

from protocol.link.events import Event
from protocol.link.session import rules_of
from protocol.messages import Measurement, Message, Offer
from protocol.scenario import Scenario
from tests.support.once import Onlooker
from wyner.simulate.engine import Law
from wyner.simulate.network import Side, Simulation


class Watched(Simulation):
    """An honest one.

    Attributes
    ----------
    onlooker : Onlooker
    sent : list of Message
        As they left, in order.
    """

    def __init__(self, scenario: Scenario, law: Law, **more: Any) -> None:
        self.onlooker = Onlooker(rules_of(scenario))
        self.sent: list[Message] = []
        super().__init__(scenario, law, **more)

    def send(self, to: Side, message: Message) -> None:
        """Look at a message, and send it."""
        self.sent.append(message)
        if isinstance(message, Measurement | Offer):
            self.onlooker.said(message)
        super().send(to, message)

    def traced(self, event: Event) -> None:
        """Look at an event."""
        super().traced(event)
        self.onlooker.traced(event)
