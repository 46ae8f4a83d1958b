"""Public messages in, transitions out: what anyone who listens can put together.

A transition is an offer that the plant really applied: x(k) from Measurement(k), the candidates and
the cipher symbol from Offer(k), and x(k+1) from any measurement that says ``applied_k = k``. The
messages may arrive twice or not at all. Each of the two senders has a connection of its own, which
keeps its order, but one may be heard long after the other. So a transition is given out, in the
order of k, once it is whole, once it is known never to have happened, or once both senders were
heard some steps later: what is missing then will not come.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from protocol.messages import FieldMessage, Measurement, Offer
from protocol.vectors import Vector

PATIENCE = 4
"""Steps by which both senders must have been heard later before a hole is given out."""

UNHEARD_PATIENCE = 64
"""The same where one of them was never heard at all."""

ONE_SIDED_PATIENCE = 1024
"""The same where one of them was heard before, and fell silent."""

JOINED_EARLY = 16
"""A session first heard at this step or before is taken from its beginning."""

LONGEST_BRIDGE = 4096
"""Missing steps that are given out as holes; a longer gap is jumped, and the jump is marked."""

ENDED_SESSIONS = 16


@dataclass(frozen=True, slots=True)
class Transition:
    """One step of the link as the public messages show it; None where a message is missing.

    Parameters
    ----------
    session : str
        The session; the automata start afresh with each.
    k : int
        The plant's step.
    x, x_next : tuple of float, shape (n,), optional
        The state in which the offer was made, and right after it was applied.
    candidates : tuple of tuple of float, shape (M, m), optional
    cipher : int, optional
    applied : bool
        Whether it is certain that the offer was applied; where a message is missing it may not be.
    start : bool
        Whether this is the first of its session, for certain.
    gap : bool
        Whether transitions right before this one were missed altogether.
    predictions : tuple of tuple of float, shape (M, n), optional
        The offer's predictions; empty where f_c is linear.
    """

    session: str
    k: int
    x: Vector | None
    candidates: tuple[Vector, ...] | None
    cipher: int | None
    x_next: Vector | None
    applied: bool = True
    start: bool = False
    gap: bool = False
    predictions: tuple[Vector, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return self.x is not None and self.candidates is not None and self.x_next is not None


def steps_in_a_row(transitions: Sequence[Transition]) -> Iterator[list[Transition]]:
    """Transitions in runs within which none was missed altogether, and no session began."""
    run: list[Transition] = []
    for t in transitions:
        if run and (t.start or t.gap or t.k != run[-1].k + 1):
            yield run
            run = []
        run.append(t)
    if run:
        yield run


def transitions_in_a_row(transitions: Sequence[Transition]) -> Iterator[list[Transition]]:
    """Transitions in runs within which the scheme goes on: none was missed, no session began.

    A step that the plant made without an offer is no transition, and ends none of these.
    """
    run: list[Transition] = []
    for t in transitions:
        if run and (t.start or t.gap or t.session != run[-1].session):
            yield run
            run = []
        run.append(t)
    if run:
        yield run


class Transcript:
    """Puts transitions together from the public messages of one loop."""

    def __init__(self) -> None:
        self.sessions = 0
        self.late = 0
        self.holes = 0
        self.jumped = 0
        self._session = ""
        self._ended: deque[str] = deque(maxlen=ENDED_SESSIONS)
        self._speaks: dict[type[Measurement | Offer], bool] = {Measurement: False, Offer: False}
        self._begin("")

    def _begin(self, session: str) -> None:
        self._session = session
        self._x: dict[int, Vector] = {}
        self._offers: dict[int, Offer] = {}
        self._after: dict[int, Vector] = {}
        self._missed: set[int] = set()
        self._next = -1
        self._newest = -1
        self._heard: dict[type[Measurement | Offer], int] = {Measurement: -1, Offer: -1}
        self._start = False
        self._gap = False

    @property
    def held(self) -> int:
        """What is kept of steps that are not finished yet: numbers and messages."""
        return len(self._x) + len(self._offers) + len(self._after) + len(self._missed)

    def hear(self, message: FieldMessage) -> list[Transition]:
        """Take one message; the transitions that are finished by it, in order."""
        finished: list[Transition] = []
        if message.session != self._session:
            if message.session in self._ended:
                self.late += 1
                return finished
            finished = self.flush()
            if self._session:
                self._ended.append(self._session)
            self._begin(message.session)
            self.sessions += 1
        k = message.k
        if self._next < 0:
            unapplied = isinstance(message, Measurement) and message.applied_k < 0
            self._start = unapplied or k <= JOINED_EARLY
            self._gap = not self._start
            self._next = k if unapplied or k > JOINED_EARLY else 0
        if isinstance(message, Offer):
            if k < self._next:
                self.late += 1
            else:
                self._offers.setdefault(k, message)
        else:
            self._note(message)
        kind = type(message)
        self._speaks[kind] = True
        self._heard[kind] = max(self._heard[kind], k)
        if k > self._newest:
            self._newest = k
            if k - self._next > LONGEST_BRIDGE:
                finished += self._jump()
        self._finish(finished)
        return finished

    def _note(self, message: Measurement) -> None:
        k, applied = message.k, message.applied_k
        if k >= self._next:
            self._x.setdefault(k, message.x)
        if applied >= self._next:
            self._after[applied] = message.x_after
        # the steps between the last applied offer and this measurement had none
        for j in range(max(applied + 1, self._next), min(k, self._next + LONGEST_BRIDGE)):
            self._missed.add(j)

    def _finish(self, finished: list[Transition], *, force: bool = False) -> None:
        while self._next <= self._newest:
            k = self._next
            if k in self._missed:
                self._forget(k)
                continue
            offer, x, after = self._offers.get(k), self._x.get(k), self._after.get(k)
            whole = offer is not None and x is not None and after is not None
            if not whole and not force and not self._given_up(k):
                return
            if force and offer is None and not self._speaks[Measurement]:
                self._forget(k)  # by offers alone it is no step either
                continue
            self.holes += not whole
            finished.append(
                Transition(
                    self._session,
                    k,
                    x,
                    None if offer is None else offer.candidates,
                    None if offer is None else offer.cipher,
                    after,
                    applied=after is not None,
                    start=self._start,
                    gap=self._gap,
                    predictions=() if offer is None else offer.predictions,
                )
            )
            self._start = self._gap = False
            self._forget(k)

    def _given_up(self, k: int) -> bool:
        """Whether what is missing of step k will not come any more."""
        behind = self._newest - k
        if behind < PATIENCE:
            return False
        one_sided = ONE_SIDED_PATIENCE if all(self._speaks.values()) else UNHEARD_PATIENCE
        return behind >= one_sided or min(self._heard.values()) >= k + PATIENCE

    def _forget(self, k: int) -> None:
        self._x.pop(k, None)
        self._offers.pop(k, None)
        self._after.pop(k, None)
        self._missed.discard(k)
        self._next = k + 1

    def _jump(self) -> list[Transition]:
        """Give up on a gap too long to bridge: settle what there is and go on behind it."""
        finished: list[Transition] = []
        known = sorted(k for k in {*self._offers, *self._after} if k < self._newest - PATIENCE)
        if known and known[-1] - self._next <= LONGEST_BRIDGE:
            newest, self._newest = self._newest, known[-1]
            self._finish(finished, force=True)
            self._newest = newest
        target = self._newest - PATIENCE
        for store in (self._x, self._offers, self._after):
            for k in [k for k in store if k < target]:
                del store[k]
        self._missed = {k for k in self._missed if k >= target}
        self.jumped += target - self._next
        self._next = target
        self._start, self._gap = False, True
        return finished

    def flush(self) -> list[Transition]:
        """Settle what is left, at the end of a transcript or of a session.

        An offer at the very end that no measurement confirms is no transition; where no measurement
        was ever heard, the next offer stands for it.
        """
        finished: list[Transition] = []
        confirmed = max(self._after, default=-1)
        if not self._speaks[Measurement]:
            confirmed = max(self._offers, default=0) - 1
        if confirmed >= 0:
            self._newest = min(self._newest, confirmed)
            self._finish(finished, force=True)
        return finished
