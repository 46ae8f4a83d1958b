"""What she holds: the public offers, and the keys that this run's eavesdropper computed."""

from collections.abc import Mapping
from typing import Any, Final

from attacker_service.base import UNKNOWN
from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage, Offer
from protocol.secret.key_digits import digits
from tap_service.capture.channel import View, WiretapChannel
from tap_service.capture.transcript import Transcript
from tap_service.eavesdroppers.base import KnowledgeError
from tap_service.eavesdroppers.key_solver import KeySolver

KEPT_OFFERS: Final = 16
"""Steps whose offers are kept: the newest is that of the step under way."""


class Offers:
    """The newest offers on the bus, by step."""

    def __init__(self) -> None:
        self._of: dict[int, Offer] = {}

    def hear(self, message: FieldMessage) -> None:
        """Note an offer; the first of a step stands, but for one of another session."""
        if not isinstance(message, Offer):
            return
        known = self._of.get(message.k)
        if known is None or known.session != message.session:
            self._of[message.k] = message
            if len(self._of) > KEPT_OFFERS:
                del self._of[min(self._of)]

    def at(self, k: int) -> Offer | None:
        """The offer of step ``k``."""
        return self._of.get(k)


class Coins:
    """The eavesdropper who goes for keys, listening through the tap's own channel.

    Parameters
    ----------
    knowledge : Knowledge
    view : mapping
        The knobs of :class:`View`.
    """

    def __init__(self, knowledge: Knowledge, view: Mapping[str, Any]) -> None:
        seen = View.model_validate(dict(view))
        self._size = knowledge.candidates
        self._digits: dict[str, tuple[int, ...]] = {}
        self._channel = WiretapChannel(seen)
        self._transcript = Transcript()
        self._solver: KeySolver | None
        try:
            self._solver = KeySolver(seen.knowledge(knowledge))
        except KnowledgeError:
            self._solver = None  # no keys are made here

    def hear(self, message: FieldMessage) -> None:
        """Let the eavesdropper hear a message, as far as her channel lets it through."""
        if self._solver is None:
            return
        for _, heard in self._channel.hear(0, message):
            settled = self._transcript.hear(heard)
            self._solver.hear(heard)
            for transition in settled:
                self._solver.observe(transition)

    def of(self, offer: Offer) -> int:
        """The candidate that she knows to be applied of an offer; :data:`UNKNOWN` without the key.

        Which key chooses it, and with which digit, stands in the offer.
        """
        name, first = offer.coin_key, offer.coin_from
        if not name or first is None or self._solver is None:
            return UNKNOWN
        if name not in self._digits:
            key = self._solver.key(name)
            if key is None:
                return UNKNOWN
            self._digits[name] = digits(key, self._size)
        place, found = offer.k - first, self._digits[name]
        return found[place] if 0 <= place < len(found) else UNKNOWN
