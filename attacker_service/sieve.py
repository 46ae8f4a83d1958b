"""What an attack hears of a bus: the loop's own messages, and none of the junk beside them."""

from typing import Final

from pydantic import ValidationError

from protocol.messages import FieldMessage, Measurement, Offer
from protocol.scenario import Scenario

LONGEST: Final = 1 << 16
"""Bytes of a message that an attack reads at most; the ends' own are far shorter."""


class Sieve:
    """Tells the loop's own messages from whatever else is on its bus.

    Parameters
    ----------
    scenario : Scenario
    """

    def __init__(self, scenario: Scenario) -> None:
        self._n = scenario.n
        self._offered = [scenario.m] * scenario.secrecy.candidates
        self._session = ""

    def read(self, kind: type[FieldMessage], payload: bytes) -> FieldMessage | None:
        """The message; None where it is none, or of another shape than the loop's."""
        try:
            message = kind.model_validate_json(payload) if len(payload) <= LONGEST else None
        except ValidationError:
            message = None
        if isinstance(message, Measurement):
            fits = len(message.x) == self._n and len(message.x_after) in (0, self._n)
        elif isinstance(message, Offer):
            fits = [len(u) for u in message.candidates] == self._offered
        else:
            fits = message is not None
        return message if fits else None

    def beside_the_plant(self, kind: type[FieldMessage], payload: bytes) -> FieldMessage | None:
        """The same, heard where the plant is: an offer of another session is none of the loop's.

        Every measurement there is the plant's own, as it published it, and names the session.
        """
        message = self.read(kind, payload)
        if isinstance(message, Measurement):
            self._session = message.session
        elif isinstance(message, Offer) and message.session != self._session:
            return None
        return message
