"""An end behind its direction of the network: messages come late, or not at all. Sans I/O."""

import heapq
from typing import Final

from pydantic import ValidationError

from protocol.link.channel import Channel
from protocol.link.effects import Effects
from protocol.link.peer import Peer
from protocol.messages import Measurement, Message, Offer
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed

UNDER_WAY: Final = 4096
"""Messages that are on their way at most; one more is lost."""


def behind(channel: Channel | None, end: Peer, kind: type[Measurement] | type[Offer]) -> Peer:
    """``end`` behind its channel; the end itself where there is none."""
    return end if channel is None else Networked(end, kind, channel)


class Networked:
    """A :class:`~protocol.link.peer.Peer` whose measurements, or offers, pass a channel first.

    Parameters
    ----------
    end : Peer
    kind : type
        `Measurement` or `Offer`, what the channel carries; everything else arrives at once.
    channel : Channel
    """

    def __init__(self, end: Peer, kind: type[Measurement] | type[Offer], channel: Channel) -> None:
        self.hears, self.says = end.hears, end.says
        self._end = end
        self._kind = kind
        self._channel = channel
        self._under_way: list[tuple[float, int, bytes]] = []
        self._number = 0

    @property
    def makes_keys(self) -> bool:
        """Whether the end has key blocks to be extracted."""
        return self._end.makes_keys

    @property
    def code(self) -> int | None:
        """The end's exit code."""
        return self._end.code

    def start(self, now: float) -> Effects:
        """The end's first word."""
        return self._end.start(now)

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Effects:
        """A message reached the network: it is lost, is under way from now on, or is there."""
        if kind is not self._kind:
            return self._end.receive(kind, payload, now)
        try:
            k = self._kind.model_validate_json(payload).k
        except ValidationError:
            return self._end.receive(kind, payload, now)
        arrives = self._channel.arrival(k, now)
        if arrives is None or len(self._under_way) >= UNDER_WAY:
            return ()
        if arrives <= now:
            return self._end.receive(kind, payload, now)
        self._number += 1
        heapq.heappush(self._under_way, (arrives, self._number, payload))
        return ()

    def wake_at(self) -> float:
        """When the end is due, or the next message is."""
        due = self._end.wake_at()
        return min(due, self._under_way[0][0]) if self._under_way else due

    def wake(self, now: float) -> Effects:
        """The message that is due, or whatever of the end's was due before it."""
        if self._under_way:
            arrives = self._under_way[0][0]
            if arrives <= now and arrives < self._end.wake_at():
                _, _, payload = heapq.heappop(self._under_way)
                return self._end.receive(self._kind, payload, now)
        return self._end.wake(now)

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Effects:
        """A key block of the end is extracted."""
        return self._end.extracted(block)

    def appear(self, count: int) -> Effects:
        """How often the end's messages leave."""
        return self._end.appear(count)

    def stop(self, now: float) -> Effects:
        """The end's last word."""
        return self._end.stop(now)
