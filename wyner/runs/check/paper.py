"""The paper's test and automata, written a second time: a second opinion on a trace.

Lucia and Youssef, "Wyner wiretap-like encoding scheme for cyber-physical systems". Nothing here is
shared with what ran: no import of the project, which a test of the walls holds. It is written to
be read beside the paper, with its symbols.

M > 2 candidates, and the scheme `pipelined`, are the project's; :func:`key_symbols` and
:class:`Automata` say where.
"""

from typing import Any, Final, NamedTuple

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
Keys = np.ndarray[Any, np.dtype[np.int64]]

NO_KEY: Final = -1
ROUNDING: Final = 2e-9
"""A vector so near to the edge of a set, in units of the set, is in it or not, whichever one says.
Sums of doubles in another order differ by less."""


def f_c(A: Array, B: Array, x: Array, u: Array) -> Array:
    """Equation (5) without its disturbance, A x + B u.

    Given are K states, shape (K, n), and the M candidates of each, shape (K, M, m); the centres
    are of shape (K, M, n).
    """
    return (x @ A.T)[:, None, :] + u @ B.T


def scale(H: Array, h: Array, x_next: Array, centre: Array) -> Array:
    """How much D = { d : H d <= h } must grow for x(k+1) to be in centre + D.

    Up to 1, (12) and (13) hold. Shapes are (K, n) of ``x_next``, (K, M, n) of ``centre``,
    and (K, M) of what is returned.
    """
    d = x_next[:, None, :] - centre
    found: Array = np.max(d @ H.T / h, axis=2)
    return found


def key_symbols(of_defender: Array, of_eavesdropper: Array) -> Keys:
    """The keys that equations (20) to (22) allow; two only where x(k+1) is on a set's edge.

    Given is how much D_c and D_e must grow about each candidate's centre (:func:`scale`), both of
    shape (K, M). Returned is one row of keys a transition, in which a key may stand repeatedly.

    (21): every candidate is possible for the eavesdropper, and not every one for the defender;
    (22): for the defender exactly one is, and that is the key. For two candidates they are one
    test. For more than two, exactly one is asked for as well.
    """
    found = []
    for edge in (1 - ROUNDING, 1 + ROUNDING):
        possible = of_defender <= edge
        one = possible.sum(axis=1) == 1
        which = possible.argmax(axis=1)
        for her_edge in (1 - ROUNDING, 1 + ROUNDING):
            agreed = one & (of_eavesdropper <= her_edge).all(axis=1)
            found.append(np.where(agreed, which, NO_KEY))
    return np.stack(found, axis=1)


def output_scale(
    A: Array, B: Array, C: Array, box: Array, u: Array, D_c: Array, N: Array, y_next: Array
) -> Array:
    """Which candidates explain y(k+1) = C (A x + B u + d) + n, as a scale for :func:`key_symbols`.

    The states x are in a ``box``, shape (K, 2, n), low and high; d and n are in boxes of these
    half-widths. Returned is 0 where a candidate explains the reading in any case, 1 where it does
    to rounding, and 2 where it does not; shape (K, M).

    Two ends that hold a box decide by intervals: the box is cut down by each output in turn and
    back through A, twice, and a candidate is ruled out where nothing of the box is left. This is
    the project's, as outputs are.
    """
    found = np.full(u.shape[:2], 2.0)
    for value, edge in ((1.0, 1 + ROUNDING), (0.0, 1 - ROUNDING)):
        centre, radius = box.mean(axis=1), edge * np.ptp(box, axis=1) / 2
        before = Boxes((centre - radius)[:, None, :], (centre + radius)[:, None, :])
        found[_left(before, A, C, u @ B.T, edge * D_c, edge * N, y_next)] = value
    return found


class Boxes(NamedTuple):
    """Boxes of vectors, low and high of shape (..., n); nothing is left of one where low > high."""

    low: Array
    high: Array

    def cut(self, row: Array, least: Array, most: Array) -> "Boxes":
        """Each without what has ``row`` x below ``least`` or above ``most`` for certain."""
        low, high = self.low.copy(), self.high.copy()
        for j in np.flatnonzero(row):
            others = np.delete(row, j)
            ends = [np.delete(v, j, axis=-1) * others for v in (low, high)]
            one = (least - np.maximum(*ends).sum(axis=-1)) / row[j]
            other = (most - np.minimum(*ends).sum(axis=-1)) / row[j]
            low[..., j] = np.maximum(low[..., j], np.minimum(one, other))
            high[..., j] = np.minimum(high[..., j], np.maximum(one, other))
        return Boxes(low, high)


TWICE: Final = 2


def _left(
    before: Boxes, A: Array, C: Array, pushes: Array, D_c: Array, N: Array, y_next: Array
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Where something is left of ``before`` once y(k+1) is known, shape (K, M)."""
    shape = pushes.shape
    before = Boxes(*(np.broadcast_to(v, shape).copy() for v in before))
    left = np.ones(shape[:2], dtype=bool)
    for _ in range(TWICE):
        ends = [v[..., None, :] * A for v in before]
        after = Boxes(
            np.minimum(*ends).sum(axis=-1) + pushes - D_c,
            np.maximum(*ends).sum(axis=-1) + pushes + D_c,
        )
        for _ in range(TWICE):
            for row, y, n in zip(C, y_next.T, N, strict=True):
                after = after.cut(row, (y - n)[:, None], (y + n)[:, None])
                left &= (after.low <= after.high).all(axis=-1)
        for i, row in enumerate(A):
            push = pushes[..., i]
            least, most = after.low[..., i] - push - D_c[i], after.high[..., i] - push + D_c[i]
            before = before.cut(row, least, most)
            left &= (before.low <= before.high).all(axis=-1)
    return left


class Entry(NamedTuple):
    """What Fig. 5 makes of one transition, as a trace has it: role, key, m[p], p, s, new key."""

    role: str
    key: int
    message_symbol: int
    p: int
    s: int
    symbol: int


class Automata:
    """Fig. 6: sender and receiver, which walk alike. In state 1 they test, in state 2 they carry.

    ``tests_always`` is the scheme `pipelined`: state 2 tests as well, and an agreement keeps it.
    """

    def __init__(self, size: int, *, tests_always: bool = False, p: int = 0) -> None:
        self.size, self.tests_always = size, tests_always
        self.s, self.key, self.p = 1, NO_KEY, p

    def step(self, b_c: int, agreed: int) -> Entry:
        """One transition that carried b_c = m[p] + key (mod M), and whose test gave ``agreed``."""
        role, key, message_symbol = "test", NO_KEY, NO_KEY
        if self.s == 2:
            role, key = "message", self.key
            message_symbol = (b_c - key) % self.size
            self.p += 1
            if not self.tests_always:
                agreed = NO_KEY
        self.s, self.key = (1, NO_KEY) if agreed == NO_KEY else (2, agreed)
        return Entry(role, key, message_symbol, self.p, self.s, agreed)
