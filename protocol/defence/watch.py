"""How many steps may go unwatched once a loop has had keys, before it is an alarm.

A step is watched where a digit of the key stream chose the plant's candidate. Whoever can drop,
repeat or change messages can keep the two ends from making keys, or end their sessions. The loop
then runs on private coins, so each unwatched step is counted, over all sessions of a journal.

The count is a cumulative sum (Page 1954): an unwatched step adds 1 - s, a watched one takes s away,
and the sum is at least 0. Above h it is an alarm, and begins again. In any n steps without an alarm
at most s n + h are unwatched.
"""

from typing import Final, NamedTuple

BLOCKS: Final = 4
"""First blocks of a session whose steps may be unwatched at once: h, so that an honest loop may
begin a few sessions in a row."""

NEVER: Final = -1.0
"""The sum of a loop that has had no keys so far: nothing is promised yet."""


class Watch(NamedTuple):
    """The rule of one loop.

    Parameters
    ----------
    share : float
        s, the share of steps that may be unwatched in the long run.
    burst : int
        h, the steps that may be unwatched at once.
    """

    share: float
    burst: int

    def after(self, before: float, *, watched: bool) -> tuple[float, bool]:
        """The sum after one more step, and whether it makes an alarm.

        Parameters
        ----------
        before : float
            The sum so far, or :data:`NEVER`.
        watched : bool
        """
        if before == NEVER:
            return (0.0 if watched else NEVER), False
        total = max(0.0, before + (1.0 - self.share if not watched else -self.share))
        alarm = total > self.burst
        return (0.0 if alarm else total), alarm

    def unheard(self, before: float) -> float:
        """The sum after a step of which nobody has heard, as at a session's end.

        Above h it makes an alarm with the next reading.
        """
        return before if before == NEVER else before + 1.0 - self.share


UNWATCHED: Final = Watch(0.5, 0)
"""Of a loop whose coin is private: no step is ever watched, so none is counted."""
