"""How long a plant waits: for an offer to apply, and at its end for the last word."""

from math import inf
from typing import Final

from protocol.link.pacing import LOCKSTEP_REPEAT_S

MEETING_S: Final = 10.0
"""Least seconds before the watchdog of a plant that has never moved: its controller is still
starting."""

FAREWELL_S: Final = 1.0
"""Seconds to wait at the end for the controller to count the last transition."""


class Watchdog:
    """Seconds without an applied offer after which the plant goes to its safe state.

    Parameters
    ----------
    seconds : float, optional
        None: it never does.

    Attributes
    ----------
    at : float
        When it does; nobody watches before :meth:`begin`.
    """

    def __init__(self, seconds: float | None) -> None:
        self._seconds = inf if seconds is None else seconds
        self.at = inf

    def patience_s(self, *, moved: bool) -> float:
        """Seconds that it allows a plant that has moved, or has not yet."""
        return self._seconds if moved else max(self._seconds, MEETING_S)

    def begin(self, now: float, *, moved: bool) -> None:
        """The process begins, and maybe without its controller."""
        self.at = now + self.patience_s(moved=moved)

    def moves(self, now: float) -> None:
        """The plant has moved for the first time: from here on the watchdog has its own time."""
        self.at = min(self.at, now + self._seconds)

    def applied(self, now: float) -> None:
        """An offer was applied."""
        self.at = now + self._seconds


class Farewell:
    """The last word: it is said again until the controller has answered, or the time is up.

    Parameters
    ----------
    round_trip_s : float
        Seconds within which the network brings an answer: it waits for so much more.

    Attributes
    ----------
    due_at : float
        When it is to be said again.
    """

    def __init__(self, round_trip_s: float) -> None:
        self._seconds = FAREWELL_S + round_trip_s
        self._gives_up_at: float | None = None
        self.due_at = -inf

    def over(self, now: float) -> bool:
        """Whether the time is up; if not, the last word is due now, and once more later."""
        if self._gives_up_at is None:
            self._gives_up_at = now + self._seconds
        self.due_at = now + LOCKSTEP_REPEAT_S
        return now >= self._gives_up_at
