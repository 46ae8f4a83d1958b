"""What may happen once, as an onlooker sees it: copy 0, nonces and digits of the key stream."""

from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import BlockEnded
from protocol.link.events import Alarm, Event
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Offer
from protocol.secret.stream import NOWHERE, Position


class Copies:
    """All messages of a loop that makes keys, as they leave (rule 8)."""

    def __init__(self) -> None:
        self._first: set[tuple[str, str, int]] = set()
        self._nonces: set[str] = set()

    def left(self, message: Measurement | Offer) -> None:
        """Look at one, and raise AssertionError where it breaks the rule."""
        at = (message.topic, message.session, message.k)
        if message.copy_number == 0:
            assert at not in self._first, "copy 0 left twice"
            self._first.add(at)
        assert message.nonce not in self._nonces, "a nonce left twice"
        self._nonces.add(message.nonce)
        assert len(message.nonce) == 44, "a nonce has another form"
        assert len(message.tag) == 32, "a tag has another form"


class Digits:
    """The positions in the key stream that offers name, and the digits that serve (rule 12).

    Parameters
    ----------
    count : int
        Digits that an offer takes.

    Attributes
    ----------
    positions : dict
        The position that the offers of each session and step name.
    served : dict
        Session and step that the digits at each position of each session served.
    watched : set of tuple
        Sessions and steps at which the controller expected a candidate.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.served: dict[tuple[str, Position], int] = {}
        self.watched: set[tuple[str, int]] = set()
        self.positions: dict[tuple[str, int], Position] = {}
        self._newest: dict[str, tuple[int, Position]] = {}
        self._applied: dict[tuple[str, int], int] = {}

    def named(self, offer: Offer) -> None:
        """An offer leaves: each step has digits of its own, and they lie beyond all before."""
        if offer.stream_block is None:
            return
        assert offer.stream_at is not None
        position, at = Position(offer.stream_block, offer.stream_at), (offer.session, offer.k)
        if position == NOWHERE:
            return
        assert self.positions.setdefault(at, position) == position, "a step was given other digits"
        k, newest = self._newest.get(offer.session, (-1, NOWHERE))
        if offer.k <= k:
            return
        free = newest if newest == NOWHERE else newest._replace(at=newest.at + self.count)
        assert position >= free, "digits were named for two steps"
        self._newest[offer.session] = offer.k, position

    def counted(self, t: CountedTransition, *, coins: bool) -> None:
        """A transition is counted; ``coins``: the digits choose the plant's."""
        if t.served:
            assert t.digits is not None
            at = t.session, t.digits
            assert self.served.setdefault(at, t.k) == t.k, "a digit served two steps"
        step = t.session, t.k
        if not coins:
            return
        if t.coin != NO_SYMBOL:
            self._applied[step] = t.coin
        elif t.expected != NO_SYMBOL:
            self.watched.add(step)
            assert self._applied.get(step, t.expected) == t.expected, "another coin was expected"


def honest(event: Event) -> None:
    """Look at what an end traces where nobody attacks."""
    if isinstance(event, Alarm):
        assert event.reason == "unwatched", "an honest step made an alarm"  # the stream was dry
    if isinstance(event, BlockEnded):
        assert event.what != "unequal", "the ends hold different blocks"
    if isinstance(event, CountedTransition):
        assert not event.refused, "a frame arrived broken"


class Onlooker:
    """Judges what both ends of an honest loop say and trace.

    Attributes
    ----------
    copies : Copies
    digits : Digits
    blocks : dict
        Keys of the blocks that an end has confirmed, by session and number.
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.copies, self.digits = Copies(), Digits(rules.digits)
        self.blocks: dict[tuple[str, int], int] = {}

    def said(self, message: Measurement | Offer) -> None:
        """An end sends a message."""
        if self._rules.schedule is not None:
            self.copies.left(message)
        if isinstance(message, Offer):
            self.digits.named(message)

    def traced(self, event: Event) -> None:
        """An end traces an event."""
        honest(event)
        if isinstance(event, BlockEnded):
            at = event.session, event.number
            assert self.blocks.setdefault(at, event.keys) == event.keys
        if isinstance(event, CountedTransition):
            self.digits.counted(event, coins=self._rules.keyed)
