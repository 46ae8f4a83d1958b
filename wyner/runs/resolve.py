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

from collections.abc import Iterable, Iterator
from enum import Enum
from typing import Any

from runtime.recording import CONTINUED, MARKS, REPORTS

Event = dict[str, Any]


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

    def transition(self, session: str, j: int, k: int, *, saved: bool = False) -> Counts:
        """Transition ``j`` of a session, made in step ``k``; ``saved`` where a journal holds it."""
        last = self.last
        if last is not None and session == last[0]:
            if not saved and self._back(j < last[1] + self._stale):
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


class Resolved:
    """The events of a trace that count, each once: iterate once.

    Of a step that was traced twice the last counts. A missed step that was traced and never saved
    does not count where it was made again. Marks of the writer's incarnations are left out.

    Parameters
    ----------
    lines : iterable of dict
        The events of a trace, marks included.

    Attributes
    ----------
    behind : int
        Steps that an end made again after its journal was put back: time went on, and nothing was
        counted.
    """

    def __init__(self, lines: Iterable[Event]) -> None:
        self.behind = 0
        self._lines = lines
        self._resolver = Resolver()
        self._held: list[Event] = []  # a step that may be made again, and what followed it

    def __iter__(self) -> Iterator[Event]:
        for event in self._lines:
            kind = event["event"]
            if kind in MARKS:
                if kind == CONTINUED:
                    self._resolver.restart()
            elif kind == "transition":
                yield from self._transition(event)
            elif kind in ("missed", "interrupted"):
                yield from self._missed(event)
            elif kind not in REPORTS or self._resolver.report() is Counts.NEW:
                if kind == "session":
                    self._resolver.session(event.get("session"))
                yield from self._next(event)
        yield from self._held

    def _transition(self, event: Event) -> Iterator[Event]:
        restarted = self._resolver.restarted
        session, k = str(event["session"]), event["k"]
        counts = self._resolver.transition(session, event["j"], k)
        if counts is Counts.NEW:
            yield from self._step(event, restarted)
        elif counts is Counts.BEHIND:
            self.behind += 1
        elif self._held and self._held[0]["event"] == "transition":
            self._held[0] = event
        else:
            self._held = self._held[1:]  # missed after it, and never saved

    def _missed(self, event: Event) -> Iterator[Event]:
        restarted = self._resolver.restarted
        if self._resolver.missed(str(event["session"]), event["k"]) is Counts.BEHIND:
            self.behind += 1
        else:
            yield from self._step(event, restarted)

    def _step(self, event: Event, restarted: bool) -> Iterator[Event]:
        held = self._held
        if restarted and held and held[0]["event"] != "transition" and _same(held[0], event):
            held = held[1:]
        self._held = [event]
        yield from held

    def _next(self, event: Event) -> Iterator[Event]:
        if self._held:
            self._held.append(event)
        else:
            yield event


def _same(a: Event, b: Event) -> bool:
    return (a.get("session"), a.get("k")) == (b.get("session"), b.get("k"))
