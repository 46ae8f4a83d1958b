"""What Eve holds: the public offers, and the keys that this run's eavesdropper computed."""

from collections.abc import Mapping
from typing import Any, Final

from attacker_service.base import UNKNOWN
from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage, Offer
from protocol.secret.stream import NOWHERE
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
        self._channel = WiretapChannel(seen)
        self._transcript = Transcript()
        self._solver: KeySolver | None
        try:
            self._solver = KeySolver(seen.knowledge(knowledge))
        except KnowledgeError:
            self._solver = None  # no keys are made here

    def hear(self, message: FieldMessage) -> None:
        """Let the eavesdropper hear a message, as far as Eve's channel lets it through."""
        if self._solver is None:
            return
        for _, heard in self._channel.hear(0, message):
            settled = self._transcript.hear(heard)
            self._solver.hear(heard)
            for transition in settled:
                self._solver.observe(transition)

    def of(self, offer: Offer) -> int:
        """The candidate that Eve knows to be applied of an offer; :data:`UNKNOWN` without the key.

        Which digit of the key stream chooses it stands in the offer.
        """
        position = offer.position
        if self._solver is None or position == NOWHERE:
            return UNKNOWN
        found = self._solver.digits(offer.session, position, 1)
        return UNKNOWN if found is None else found[0]
