"""An end of the link that keeps what it hears: for the tests of what stands before an end."""

from typing import ClassVar

from protocol.link.channel import Channel
from protocol.link.effects import Effects, Publish
from protocol.link.endpoint import Endpoint
from protocol.messages import ControllerHello, Message, Offer


class Hearing(Endpoint):
    """All that it does publishes ``says_now``.

    Attributes
    ----------
    heard : list of (float, Message)
        When, and what.
    woken : list of float
        When.
    """

    receives: ClassVar[tuple[type[Message], ...]] = (Offer, ControllerHello)
    sends: ClassVar[tuple[type[Message], ...]] = ()

    def __init__(self, due: float, channel: Channel | None = None) -> None:
        super().__init__("1" * 16, channel)
        self.due = due
        self.says_now: tuple[Message, ...] = ()
        self.heard: list[tuple[float, Message]] = []
        self.woken: list[float] = []

    def hear(self, message: Message, now: float) -> Effects:
        self.heard.append((now, message))
        return [Publish(message) for message in self.says_now]

    def due_at(self) -> float:
        return self.due

    def act(self, now: float) -> Effects:
        self.woken.append(now)
        self.due = now + 10.0
        return ()

    def start(self, now: float) -> Effects:
        raise AssertionError(now)

    def stop(self, now: float) -> Effects:
        raise AssertionError(now)
