"""An end of the link that keeps what it hears: for the tests of what stands before an end."""

from protocol.link.effects import Effects, Publish
from protocol.messages import Message
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed


class Hearing:
    """All that it does publishes ``says_now``.

    Attributes
    ----------
    heard : list of (float, type, bytes)
        When, and what.
    started, woken, stopped : list of float
        When.
    appearances : int
        How often its messages leave.
    blocks : list
        Key blocks that it was told of.
    """

    hears: tuple[type[Message], ...] = ()
    says: tuple[type[Message], ...] = ()
    code = None
    makes_keys = False

    def __init__(self, due: float) -> None:
        self.due = due
        self.says_now: tuple[Message, ...] = ()
        self.heard: list[tuple[float, type[Message], bytes]] = []
        self.started: list[float] = []
        self.woken: list[float] = []
        self.stopped: list[float] = []
        self.appearances = 0
        self.blocks: list[ExtractedBlock | ExtractionFailed] = []

    def _said(self) -> Effects:
        return [Publish(message) for message in self.says_now]

    def start(self, now: float) -> Effects:
        self.started.append(now)
        return self._said()

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Effects:
        self.heard.append((now, kind, payload))
        return self._said()

    def wake_at(self) -> float:
        return self.due

    def wake(self, now: float) -> Effects:
        self.woken.append(now)
        self.due = now + 10.0
        return self._said()

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Effects:
        self.blocks.append(block)
        return self._said()

    def appear(self, count: int) -> Effects:
        self.appearances = count
        return self._said()

    def stop(self, now: float) -> Effects:
        self.stopped.append(now)
        return self._said()
