"""What may happen once, as an onlooker sees it: copy 0, nonces and digits of the key stream."""

from protocol.agreement import NO_SYMBOL
from protocol.link.session import CountedTransition
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
    served : dict
        Session and step that the digits at each position of each session served.
    watched : set of tuple
        Sessions and steps at which the controller expected a candidate.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.served: dict[tuple[str, Position], int] = {}
        self.watched: set[tuple[str, int]] = set()
        self._named: dict[tuple[str, int], Position] = {}
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
        assert self._named.setdefault(at, position) == position, "a step was given other digits"
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
