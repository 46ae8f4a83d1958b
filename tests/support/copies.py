"""Rule 8 as an onlooker sees it: copy 0 leaves at most once, and no nonce leaves twice."""

from protocol.messages import Measurement, Offer


class Copies:
    """All messages of a loop that makes keys, as they leave."""

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
