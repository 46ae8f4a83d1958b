"""Inference where outputs alone are read: what was applied, and which steps the two ends lost.

Transitions are held until the readings show what was applied.
"""

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from protocol.arrays import Array, Integers
from protocol.vectors import Vector
from tap_service.capture.transcript import Transition, transitions_in_a_row
from tap_service.inference.output_model import BRIDGED, LATER, LOST, OutputModel
from tap_service.inference.verdicts import Inferred, InferredStep

AGAIN: Final = 8
"""Steps after a stretch of missed ones, one of which is the first that the ends agreed on again."""

AT_FIRST: Final = 0.5
"""Probability that the two ends lose one more of a session's first steps."""

TOO_MANY: Final = 6
"""Missed steps in a row that widen the box so far that the step after them is lost."""

MOST_SURE: Final = 0.9
"""Probability of that at most."""


class Known(NamedTuple):
    """A transition, the candidate applied, and its place where the two ends may have lost it.

    Parameters
    ----------
    transition : Transition
    symbol : int, optional
        None: no offer was heard.
    place : int
        Steps since the session's beginning, or since a stretch of missed steps; -1 where she heard
        neither.
    again : int
        Missed steps of the stretch; 0 at a session's beginning.
    shares : tuple of float, shape (M,)
        Probability of each candidate.
    """

    transition: Transition
    symbol: int | None
    place: int
    again: int = 0
    shares: Vector = ()

    @property
    def doubtful(self) -> bool:
        """Whether the two ends may have lost it."""
        return 0 <= self.place < (AGAIN if self.again else LOST)


def lost_after(missed: int) -> float:
    """Probability that the two ends lose the step after so many missed ones."""
    return min((missed / TOO_MANY) ** 2, MOST_SURE)


class Opening:
    """Takes transitions, and gives them out once she knows what was applied.

    Parameters
    ----------
    model : OutputModel
    size : int
        M.
    """

    lost = range(1, LOST + 1)
    """Numbers of first steps that the two ends may have lost."""

    def __init__(self, model: OutputModel, size: int) -> None:
        self._model, self._size = model, size
        self._held: deque[tuple[Transition, int, int]] = deque()
        self._place, self._again = -1, 0
        self._session, self._k = "", -1

    def take(self, t: Transition) -> tuple[list[Known], list[float] | None]:
        """The transitions that are known by this one, in order; and its gauges at first sight."""
        given: list[Known] = []
        anew = t.start or t.gap or t.session != self._session
        if anew:
            given = self.flush()
            self._place, self._again = 0 if t.start else -1, 0
        elif t.k != self._k:
            if not 0 <= t.k - self._k <= BRIDGED:
                given = self.flush()
            self._place, self._again = 0, max(t.k - self._k, 1)
        self._session, self._k = t.session, t.k + 1
        gauges = self._model.observe(t)
        self._held.append((t, self._place, self._again))
        self._place += self._place >= 0
        if len(self._held) > LATER:
            given += self._out(1)
        return given, gauges

    def flush(self) -> list[Known]:
        """What is held, with what she knows by now."""
        return self._out(len(self._held))

    def _out(self, count: int) -> list[Known]:
        """The oldest of those held."""
        shares, applied = self._model.shares(self._size), self._model.applied
        past = len(self._held) - len(applied)  # of these the model knows no more
        given = []
        for i in range(count):
            t, place, again = self._held.popleft()
            known = i >= past and applied[i - past] >= 0
            symbol = applied[i - past] if known else None
            row = tuple(shares[i - past].tolist()) if known else ()
            given.append(Known(t, symbol, place, again, row))
        return given


TRAJECTORIES: Final = 64
"""Numbers of lost steps, and candidates applied, that `text` weighs as equally likely ones."""


def inferred(model: OutputModel, size: int, transitions: Sequence[Transition]) -> Inferred:
    """A transcript as `text` reads it: how many steps were lost is a trajectory of 64.

    Of a session's first, half of them lose one, a quarter two, and so on; after a stretch of missed
    steps as many lose one as it was long, and half of these another.

    Where her own receiver adds noise, as many go along a candidate as it is likely; which ones is
    drawn for each step. Elsewhere all go along the likeliest: the readings tell it, and a filter
    that takes a bounded disturbance for a normal one is less sure than it is right.
    """
    rng = np.random.default_rng(0)
    steps = []
    for run in transitions_in_a_row(transitions):
        opening = Opening(model, size)
        known = [one for t in run for one in opening.take(t)[0]] + opening.flush()
        for one in known:
            lost = _lost(lost_after(one.again)) if one.again else 1 + _lost(AT_FIRST)
            samples = _samples(one, _applied(one, rng, noisy=model.noise > 0), size, lost)
            steps.append(InferredStep(one.transition, samples))
    return Inferred(steps, (0.0, 1.0))


def _lost(more: float) -> Integers:
    """Steps lost in each trajectory: ``more`` of them lose one, half of these another."""
    at = (np.arange(TRAJECTORIES) + 0.5) / TRAJECTORIES
    lost = np.floor(1 + np.log2(more / at)).clip(0, LOST - 1)
    found: Integers = lost.astype(int)
    return found


def _applied(one: Known, rng: np.random.Generator, *, noisy: bool) -> Integers | None:
    """The candidate applied in each trajectory, one for all where there is no doubt."""
    if one.symbol is None:
        return None
    if not noisy:
        return np.array([one.symbol])
    at = (np.arange(TRAJECTORIES) + 0.5) / TRAJECTORIES
    share = np.cumsum(one.shares)
    symbols: Integers = np.searchsorted(share, at * share[-1])
    if (symbols == symbols[0]).all():
        return symbols[:1]
    rng.shuffle(symbols)
    return symbols


def _samples(one: Known, applied: Integers | None, size: int, lost: Integers) -> Array | None:
    """Gauges that agree for all thresholds between 0 and 1, or for none."""
    if applied is None:
        return None
    agrees = 1.0 - np.eye(size)[applied]
    if not one.doubtful:
        return agrees
    out = np.repeat(agrees, len(lost) // len(agrees), axis=0)
    out[lost > one.place] = 1.0
    return out
