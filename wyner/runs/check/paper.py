"""The paper's test and automata, written a second time: a second opinion on a trace.

Lucia and Youssef, "Wyner wiretap-like encoding scheme for cyber-physical systems". Nothing here is
shared with what ran: no import of the project, which a test of the walls holds. It is written to
be read beside the paper, with its symbols, and not to be fast.

M > 2 candidates, and the scheme `pipelined`, are the project's; :func:`key_symbols` and
:class:`Automata` say where.
"""

from collections.abc import Sequence
from typing import NamedTuple

Vector = Sequence[float]
Rows = Sequence[tuple[Vector, float]]
"""{ d : a d <= b for each row (a, b) }."""

NO_KEY = -1
ROUNDING = 2e-9
"""A vector so near to the edge of a set, in units of the set, is in it or not, whichever one says.
Sums of doubles in another order differ by less."""


def dot(a: Vector, b: Vector) -> float:
    """The inner product of two vectors."""
    total = 0.0
    for v, w in zip(a, b, strict=True):
        total += v * w
    return total


def f_c(A: Sequence[Vector], B: Sequence[Vector], x: Vector, u: Vector) -> list[float]:
    """Equation (5) without its disturbance: A x + B u."""
    return [dot(row_a, x) + dot(row_b, u) for row_a, row_b in zip(A, B, strict=True)]


def scale(D: Rows, x_next: Vector, centre: Vector) -> float:
    """How much D must grow for x(k+1) to be in centre + D: (12) and (13) hold up to 1."""
    d = [a - b for a, b in zip(x_next, centre, strict=True)]
    return max(dot(row, d) / bound for row, bound in D)


def key_symbols(of_defender: Vector, of_eavesdropper: Vector) -> set[int]:
    """The keys that equations (20) to (22) allow; two only where x(k+1) is on a set's edge.

    Given is how much D_c and D_e must grow about each candidate's centre (:func:`scale`).

    (21): every candidate is possible for the eavesdropper, and not every one for the defender;
    (22): for the defender exactly one is, and that is the key. For two candidates they are one
    test. For more than two, exactly one is asked for as well.
    """
    found = set()
    for edge in (1 - ROUNDING, 1 + ROUNDING):
        possible = [i for i, s in enumerate(of_defender) if s <= edge]
        for her_edge in (1 - ROUNDING, 1 + ROUNDING):
            agreed = len(possible) == 1 and max(of_eavesdropper) <= her_edge
            found.add(possible[0] if agreed else NO_KEY)
    return found


class Line(NamedTuple):
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

    def step(self, b_c: int, agreed: int) -> Line:
        """One transition that carried b_c = m[p] + key (mod M), and whose test gave ``agreed``."""
        role, key, message_symbol = "test", NO_KEY, NO_KEY
        if self.s == 2:
            role, key = "message", self.key
            message_symbol = (b_c - key) % self.size
            self.p += 1
            if not self.tests_always:
                agreed = NO_KEY
        self.s, self.key = (1, NO_KEY) if agreed == NO_KEY else (2, agreed)
        return Line(role, key, message_symbol, self.p, self.s, agreed)
