"""What may happen once, as an onlooker sees it: copy 0, nonces and digits of keys."""

from protocol.agreement import NO_SYMBOL
from protocol.link.session import CountedTransition
from protocol.messages import Measurement, Offer


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
    """All coins of a loop whose coin is keyed, as both ends count them (rule 12).

    Attributes
    ----------
    served : dict
        Session and step that each digit served, by key and number.
    watched : set of tuple
        Sessions and steps at which the controller expected a candidate.
    """

    def __init__(self) -> None:
        self.served: dict[tuple[str, int], tuple[str, int]] = {}
        self.watched: set[tuple[str, int]] = set()
        self._applied: dict[tuple[str, int], int] = {}

    def counted(self, t: CountedTransition) -> None:
        """A keyed coin is the digit of its step alone, and who watches it expects that one."""
        at = t.session, t.k
        if t.coin == NO_SYMBOL:
            if t.expected != NO_SYMBOL:
                self.watched.add(at)
                assert self._applied.get(at, t.expected) == t.expected, "another coin was expected"
            return
        self._applied[at] = t.coin
        if t.coin_key:
            digit = t.coin_key, t.k - t.coin_from
            assert self.served.setdefault(digit, at) == at, "a digit served two steps"
