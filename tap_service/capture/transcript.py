"""Public messages in, transitions out: what anyone who listens can put together.

A transition is an offer that the plant really applied: x(k) from Measurement(k), the candidates and
the cipher symbol from Offer(k), and x(k+1) from any measurement that says ``applied_k = k``. The
messages may arrive twice or not at all. Each of the two senders has a connection of its own, which
keeps its order, but one may be heard long after the other. So a transition is given out, in the
order of k, once it is whole, once it is known never to have happened, or once both senders were
heard some steps later: what is missing then will not come.

One message proves nothing: it may be a stray of another loop, a replay or a forgery. A message of
another session, or of a step far ahead, is therefore held apart. Its session, or its step, is
followed once :data:`CONFIRMED` such messages arrived while the session that is followed went no
further; until then it costs nothing. Messages that were never used are counted.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

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

FAR_AHEAD = 64
"""Steps beyond the newest from which a message is held apart until others confirm it."""

CONFIRMED = 16
"""Messages of one other session, or of steps far ahead, after which it is followed: eight steps."""

TOGETHER = 256
"""Steps within which messages confirm each other."""

CREDIBLE = 3
"""Messages without which a session at the end of a transcript is not taken for one: a step has
two, and the next measurement confirms it."""

OTHERS_KEPT = 4
"""Other sessions of which messages are held."""

HELD_APART = 256
"""Messages that are held of each of them."""

SETTLED_SESSIONS = 16
"""Sessions of which the next step is remembered, should one be followed again."""

REMEMBERED = 4096
"""Steps that were given out of which it is remembered what was missing, so that a message which
arrives too late is counted as such."""


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
    return _runs(transitions, lambda before, t: t.k != before.k + 1)


def transitions_in_a_row(transitions: Sequence[Transition]) -> Iterator[list[Transition]]:
    """Transitions in runs within which the scheme goes on: none was missed, no session began.

    A step that the plant made without an offer is no transition, and ends none of these.
    """
    return _runs(transitions, lambda before, t: t.session != before.session)


def _runs(
    transitions: Sequence[Transition], ends: Callable[[Transition, Transition], bool]
) -> Iterator[list[Transition]]:
    """Transitions in runs, that end where a session begins, after a gap and as told."""
    run: list[Transition] = []
    for t in transitions:
        if run and (t.start or t.gap or ends(run[-1], t)):
            yield run
            run = []
        run.append(t)
    if run:
        yield run


class Unused(NamedTuple):
    """What a transcript could not use of the messages that it was handed.

    Parameters
    ----------
    foreign : int
        Messages of other sessions, or of steps far ahead, that no others confirmed.
    late : int
        Messages that came after their step was given out without them.
    jumped : int
        Steps that were skipped, as nothing was heard of more than :data:`LONGEST_BRIDGE` in a row.
    """

    foreign: int = 0
    late: int = 0
    jumped: int = 0


Part = Literal["offer", "measurement", "after"]
"""A part of a step's transition: the offer, the state before it, the state after it."""

PARTS: tuple[Part, ...] = ("offer", "measurement", "after")


class Lacking:
    """Which parts of the last :data:`REMEMBERED` steps were missing, a bit each."""

    def __init__(self) -> None:
        self._bits = dict.fromkeys(PARTS, 0)

    def forget(self, steps: int, *missing: Part) -> None:
        """So many steps are given out, or skipped; these parts of them are missing."""
        steps = min(steps, REMEMBERED)
        for part in PARTS:
            new = (1 << steps) - 1 if part in missing else 0
            self._bits[part] = (self._bits[part] << steps | new) & (1 << REMEMBERED) - 1

    def fill(self, part: Part, ago: int) -> bool:
        """Whether that part is missing of the step so many before the next; then no longer."""
        found = 0 < ago <= REMEMBERED and self._bits[part] >> ago - 1 & 1
        if found:
            self._bits[part] ^= 1 << ago - 1
        return bool(found)


class Transcript:
    """Puts transitions together from the public messages of one loop.

    Attributes
    ----------
    sessions : int
        Sessions that were followed.
    holes : int
        Transitions that were given out with something missing.
    """

    def __init__(self) -> None:
        self.sessions = 0
        self.holes = 0
        self._late = 0
        self._foreign = 0
        self._jumped = 0
        self._session = ""
        self._arrived = 0
        self._others: dict[str, dict[tuple[Part, int], tuple[int, Measurement | Offer]]] = {}
        self._settled: dict[str, int] = {}
        self._begin("")

    def _begin(self, session: str) -> None:
        self._session = session
        self._progressed_at = self._arrived
        self._x: dict[int, Vector] = {}
        self._offers: dict[int, Offer] = {}
        self._after: dict[int, Vector] = {}
        self._missed: set[int] = set()
        self._lacking = Lacking()
        self._taken = 0
        self._next = -1
        self._newest = -1
        self._speaks: dict[type[Measurement | Offer], bool] = {Measurement: False, Offer: False}
        # of each sender the largest steps: one alone may have come before its time
        self._heard = {kind: [-1] * CREDIBLE for kind in (Measurement, Offer)}
        self._start = False
        self._gap = False

    @property
    def held(self) -> int:
        """What is kept of steps that are not finished yet: numbers and messages."""
        mine = len(self._x) + len(self._offers) + len(self._after) + len(self._missed)
        return mine + sum(map(len, self._others.values()))

    @property
    def unused(self) -> Unused:
        """What could not be used so far; messages that are held apart may be used yet."""
        held = sum(map(len, self._others.values()))
        return Unused(self._foreign + held, self._late, self._jumped)

    def hear(self, message: FieldMessage) -> list[Transition]:
        """Take one message; the transitions that are finished by it, in order."""
        finished: list[Transition] = []
        self._arrived += 1
        if not self._session or (message.session == self._session and self._fits(message.k)):
            self._take(message, finished)
            return finished
        self._hold(message)
        since = self._since(message.session)
        if len(since) >= CONFIRMED:
            for session in list(self._others):
                passed = self._since(session)  # a short session between the two
                if len(passed) >= CREDIBLE and passed[-1][0] < since[0][0]:
                    self._follow(passed[-1][1], finished)
            self._follow(message, finished)
        return finished

    def _since(self, session: str) -> list[tuple[int, Measurement | Offer]]:
        """Messages of another session, that confirm its last one, since ours went no further."""
        newest = [*self._others[session].values()][-1][1]
        return [one for one in self._together(newest) if one[0] > self._progressed_at]

    def _fits(self, k: int) -> bool:
        """Whether a step is one that the session may be at; until a few messages agree, none is
        before the first."""
        if self._newest < 0:
            return True
        return k <= self._newest + FAR_AHEAD and (k >= self._next or self._taken >= CREDIBLE)

    def _hold(self, message: Measurement | Offer) -> None:
        """Hold a message apart; the oldest go, and are counted, where there are too many."""
        held = self._others.pop(message.session, {})
        self._others[message.session] = held  # in the order in which they were heard last
        held.setdefault((_kind(message), message.k), (self._arrived, message))
        if len(held) > HELD_APART:
            del held[next(iter(held))]
            self._foreign += 1
        if len(self._others) > OTHERS_KEPT:
            self._foreign += len(self._others.pop(next(iter(self._others))))

    def _together(self, message: Measurement | Offer) -> list[tuple[int, Measurement | Offer]]:
        """Messages held apart of the same session and of steps nearby, in order."""
        held = self._others[message.session].values()
        return [one for one in held if abs(one[1].k - message.k) <= TOGETHER]

    def _follow(self, message: Measurement | Offer, finished: list[Transition]) -> None:
        """Go on with the session and the step of a message that others confirm."""
        confirmed = [one for one in self._together(message) if one[1].k <= message.k + FAR_AHEAD]
        self._foreign += len(self._others.pop(message.session)) - len(confirmed)
        if message.session != self._session or message.k < self._next:
            self._end_session(finished)
            self._begin(message.session)
        # by step: one that is ahead of the others may be a stray, and must not begin the session
        for one in sorted((one for _, one in confirmed), key=lambda one: one.k):
            self._take(one, finished)

    def _end_session(self, finished: list[Transition]) -> None:
        """Settle what is left of the session; one of a message or two never was a session."""
        if self._taken < CREDIBLE:
            self._foreign += self._taken
            return
        self._settle(finished)
        self._settled.pop(self._session, None)
        self._settled[self._session] = self._next
        if len(self._settled) > SETTLED_SESSIONS:
            del self._settled[next(iter(self._settled))]

    def _take(self, message: Measurement | Offer, finished: list[Transition]) -> None:
        """Use a message of the session that is followed."""
        k = message.k
        if not self._session:
            self._begin(message.session)
        if self._next < 0:
            self._join(message)
        if isinstance(message, Offer):
            if k < self._next:
                self._late += self._lacking.fill("offer", self._next - k)
            else:
                self._offers.setdefault(k, message)
        else:
            self._note(message)
        kind = type(message)
        self._speaks[kind] = True
        heard = self._heard[kind]
        if k > heard[0]:
            self._progressed_at = self._arrived
            self._taken += 1
        if k not in heard:
            self._heard[kind] = sorted((*heard, k), reverse=True)[:CREDIBLE]
        if k > self._newest:
            self._newest = k
            if k - self._next > LONGEST_BRIDGE:
                finished += self._jump()
        self._finish(finished)

    def _join(self, message: Measurement | Offer) -> None:
        """Begin with the first message of a session: from its beginning, or in its middle."""
        k = message.k
        before = self._settled.get(self._session)
        unapplied = isinstance(message, Measurement) and message.applied_k < 0
        self._start = before is None and (unapplied or k <= JOINED_EARLY)
        self._gap = not self._start
        self._next = k if unapplied or k > JOINED_EARLY else 0
        if before is not None:
            self._next = max(self._next, before)
        self.sessions += 1

    def _note(self, message: Measurement) -> None:
        k, applied = message.k, message.applied_k
        if k >= self._next:
            self._x.setdefault(k, message.x)
        if applied >= self._next:
            self._after[applied] = message.x_after
        before = self._lacking.fill("measurement", self._next - k)
        after = applied >= 0 and self._lacking.fill("after", self._next - applied)
        self._late += before or after
        # the steps between the last applied offer and this measurement had none
        for j in range(max(applied + 1, self._next), min(k, self._next + LONGEST_BRIDGE)):
            self._missed.add(j)

    def _finish(self, finished: list[Transition], *, force: bool = False) -> None:
        while self._next <= self._newest:
            k = self._next
            if k in self._missed:
                self._forget(k, "after")  # should another message say that it was applied
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
            shown = zip(PARTS, (offer, x, after), strict=True)
            self._forget(k, *(part for part, value in shown if value is None))

    def _given_up(self, k: int) -> bool:
        """Whether what is missing of step k will not come any more."""
        # a message that came before its time does not end the steps that it overtook
        heard = [steps[-1] + CREDIBLE - 1 for steps in self._heard.values()]
        one_sided = ONE_SIDED_PATIENCE if all(self._speaks.values()) else UNHEARD_PATIENCE
        return max(heard) >= k + one_sided or min(heard) >= k + PATIENCE

    def _forget(self, k: int, *missing: Part) -> None:
        self._lacking.forget(1, *missing)
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
        self._jumped += target - self._next
        self._lacking.forget(target - self._next, *PARTS)
        self._next = target
        self._start, self._gap = False, True
        return finished

    def flush(self) -> list[Transition]:
        """Settle what is left, at the end of a transcript.

        An offer at the very end that no measurement confirms is no transition; where no measurement
        was ever heard, the next offer stands for it.
        """
        finished: list[Transition] = []
        for session in list(self._others):
            since = self._since(session)
            if len(since) >= CREDIBLE:
                self._follow(since[-1][1], finished)
        self._foreign += sum(map(len, self._others.values()))
        self._others.clear()
        if self._taken < CREDIBLE and self.sessions > 1:
            self._foreign += self._taken
        else:
            self._settle(finished)
        return finished

    def _settle(self, finished: list[Transition]) -> None:
        """Give out what is left of the session that is followed."""
        confirmed = max(self._after, default=-1)
        if not self._speaks[Measurement]:
            confirmed = max(self._offers, default=0) - 1
        if confirmed >= 0:
            self._newest = min(self._newest, confirmed)
            self._finish(finished, force=True)


def _kind(message: Measurement | Offer) -> Literal["offer", "measurement"]:
    return "offer" if isinstance(message, Offer) else "measurement"
