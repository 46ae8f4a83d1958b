"""What a killed writer leaves in its trace, and what of it counts.

A process that dies over a step may have traced it and not saved it. The one that follows makes the
step again, and traces it again:

    transition 7                 traced, and its report
    continued                    another process
    transition 7                 the same once more, and its report
    transition 8

One whose journal was put back from an older copy goes back further, and makes steps again that are
counted already, until the other end makes the session end.
"""

from enum import Enum


class Counts(Enum):
    """What a line of a trace is to one who counts."""

    NEW = "new"
    AGAIN = "the same as one before"
    BEHIND = "made again by an end that was put back"


class Resolver:
    """Says of each line of a trace, in order, what it is to one who counts.

    Attributes
    ----------
    last : tuple of (str, int, int) or None
        Session, number and step of the last transition that was new.
    restarted : bool
        Whether another process has begun to write since the last step.
    """

    def __init__(self) -> None:
        self.last: tuple[str, int, int] | None = None
        self.restarted = True
        self._stale = False  # an end that was put back makes counted steps again
        self._reported: tuple[str, int, int] | None = None

    def restart(self) -> None:
        """Another process goes on."""
        self.restarted = True

    def session(self, name: str | None) -> None:
        """A session was announced."""
        self._stale = self._stale and self.last is not None and name == self.last[0]

    def begin_after(self, session: str, j: int, k: int) -> None:
        """Take a transition as the last, whatever came before it."""
        self.last, self.restarted = (session, j, k), False

    def transition(self, session: str, j: int, k: int) -> Counts:
        """Transition ``j`` of a session, made in step ``k``."""
        last = self.last
        if last is not None and session == last[0]:
            if self._back(j < last[1] + self._stale):
                return Counts.BEHIND
            if j == last[1]:
                self.restarted = False
                return Counts.AGAIN
        self.restarted = False
        self.last = session, j, k
        return Counts.NEW

    def missed(self, session: str, k: int) -> Counts:
        """A step without a counted offer."""
        last = self.last
        if last is not None and session == last[0] and self._back(k <= last[2]):
            return Counts.BEHIND
        self.restarted = False
        return Counts.NEW

    def report(self) -> Counts:
        """A report on the last transition."""
        if self._stale:
            return Counts.BEHIND
        if self.last is not None and self._reported == self.last:
            return Counts.AGAIN
        self._reported = self.last
        return Counts.NEW

    def _back(self, passed: bool) -> bool:
        if passed:
            self._stale = self._stale or self.restarted
            return self._stale
        return False
