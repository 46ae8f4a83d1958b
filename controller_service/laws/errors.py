"""What a law raises where it has no candidates; nothing here loads numerics."""

from protocol.errors import WynerError


class OutsideError(WynerError, LookupError):
    """A state outside every T_i; the message names the state, the largest set and the distance."""


class ProgramError(WynerError, LookupError):
    """A program without an answer that satisfies its constraints."""
