"""The recursion of a planar plant in rational arithmetic: slow, independent, exact.

It shares no code with the synthesis. Rows are integers (a_1, a_2, b) meaning a' x <= b, a row's
positive factor being free; a new row's factor is the determinant of its neighbours. The plant's
numbers are taken as printed (0.0975 is 975/10000).

Normals are exact throughout. An offset's digits multiply with every generation of rows, a hundred
thousand bits at index 200, so each is rounded outwards to 256 bits behind the point of its unit
normal: the sets are too large by less than 1e-70. ``bits=None`` keeps every digit.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cmp_to_key
from math import gcd, lcm
from typing import Final

import numpy as np

from protocol.arrays import Array

UNBOUNDED: Final = 1e6
"""Reported as the relative error of a set that has become unbounded."""

Row = tuple[int, int, int]
Numbers = Sequence[Sequence[float]]


def printed(value: float) -> Fraction:
    """The decimal number that stands in the scenario file."""
    return Fraction(repr(float(value)))


def whole(a1: Fraction, a2: Fraction, b: Fraction) -> Row:
    """The row in integers without a common factor."""
    scale = lcm(a1.denominator, a2.denominator, b.denominator)
    return reduced(*(int(v * scale) for v in (a1, a2, b)))


def reduced(a1: int, a2: int, b: int) -> Row:
    """The row divided by its common factor."""
    common = gcd(a1, a2, b)
    return a1 // common, a2 // common, b // common


def rounded(row: Row, bits: int) -> Row:
    """The row with a primitive normal, its offset rounded up to ``bits`` binary digits."""
    a1, a2, b = row
    common = gcd(a1, a2)
    return (a1 // common) << bits, (a2 // common) << bits, -((-b << bits) // common)


def cross(a: Row, b: Row) -> int:
    """Positive when b's normal is less than half a turn counter-clockwise of a's."""
    return a[0] * b[1] - a[1] * b[0]


def _angle_order(a: Row, b: Row) -> int:
    upper_a = a[1] > 0 or (a[1] == 0 and a[0] > 0)
    upper_b = b[1] > 0 or (b[1] == 0 and b[0] > 0)
    if upper_a != upper_b:
        return -1 if upper_a else 1
    turn = cross(a, b)
    return -1 if turn > 0 else (1 if turn < 0 else 0)


def irredundant(rows: Sequence[Row]) -> list[Row]:
    """Sort by angle and drop what the others imply, exactly."""
    rest = sorted(rows, key=cmp_to_key(_angle_order))
    j, kept = 0, 0
    while kept <= len(rest):
        a, b, c = rest[j - 1], rest[j], rest[(j + 1) % len(rest)]
        if cross(a, b) == 0 and a[0] * b[0] + a[1] * b[1] > 0:
            # Parallel rows: compare b / |a| without roots, along the larger component.
            k = 0 if a[0] else 1
            drop = b[2] * abs(a[k]) >= a[2] * abs(b[k])
            del rest[j if drop else j - 1]
            j, kept = max(0, j - 2), 0
            j %= len(rest)
            continue
        if cross(a, c) > 0 and cross(b, c) * a[2] + cross(a, b) * c[2] <= b[2] * cross(a, c):
            del rest[j]
            j, kept = (j - 1) % len(rest), 0
            continue
        j, kept = (j + 1) % len(rest), kept + 1
    return rest


def exact_sets(
    A: Numbers,
    B: Numbers,
    disturbance: Sequence[float],
    input_bound: float,
    start: tuple[Numbers, Sequence[float]],
    horizon: int,
    bits: int | None = 256,
) -> Iterator[list[Row]]:
    """Yield T_0..T_horizon of a plant with two states, one input, box D_c and symmetric U.

    Parameters
    ----------
    start : (H, h)
        T_0, its floats taken as the exact binary fractions that they are.
    bits : int, optional
        Binary digits kept of an offset beside its normal; None for all.
    """

    def kept(row: Row) -> Row:
        return row if bits is None else rounded(row, bits)

    (a11, a12), (a21, a22) = ((printed(v) for v in row) for row in A)
    b1, b2 = (printed(row[0]) for row in B)
    d1, d2 = (printed(v) for v in disturbance)
    u = printed(input_bound)
    rows = irredundant(
        [
            whole(Fraction(p), Fraction(q), Fraction(r))
            for (p, q), r in zip(start[0], start[1], strict=True)
        ]
    )
    yield rows
    across = whole(-b2, b1, Fraction(0))
    for _ in range(horizon):
        eroded = irredundant([whole(p, q, r - d1 * abs(p) - d2 * abs(q)) for p, q, r in _fr(rows)])
        grown = list(eroded)
        for sign in (1, -1):
            d = (sign * across[0], sign * across[1], 0)
            a, c = _neighbours(eroded, d)
            det = cross(a, c)
            grown.append(reduced(d[0] * det, d[1] * det, cross(d, c) * a[2] + cross(a, d) * c[2]))
        rows = irredundant(
            [
                kept(whole(p * a11 + q * a21, p * a12 + q * a22, r + u * abs(p * b1 + q * b2)))
                for p, q, r in _fr(grown)
            ]
        )
        yield rows


def _fr(rows: Sequence[Row]) -> Iterator[tuple[Fraction, Fraction, Fraction]]:
    for p, q, r in rows:
        yield Fraction(p), Fraction(q), Fraction(r)


def _neighbours(rows: Sequence[Row], d: Row) -> tuple[Row, Row]:
    for j in range(len(rows)):
        a, c = rows[j - 1], rows[j]
        if cross(a, d) >= 0 and cross(d, c) > 0:
            return a, c
    raise ValueError("the set is unbounded")


def support(rows: Sequence[Row], direction: tuple[Fraction, Fraction]) -> Fraction:
    """The largest direction' x over the set."""
    scale = lcm(direction[0].denominator, direction[1].denominator)
    d = (int(direction[0] * scale), int(direction[1] * scale), 0)
    a, c = _neighbours(rows, d)
    return Fraction(cross(d, c) * a[2] + cross(a, d) * c[2], cross(a, c)) / scale


def relative_errors(H: Array, h: Array, exact: list[Row]) -> tuple[float, float]:
    """Largest and smallest of (our support - exact support) / exact support; above 0 is unsound.

    Both sets' facets are looked at: ours against the exact support, and the exact set's normals
    against ours, so a facet that is missing shows.
    """
    errors = [
        float(Fraction(b) / support(exact, (Fraction(p), Fraction(q))) - 1)
        for (p, q), b in zip(H.tolist(), h.tolist(), strict=True)
    ]
    order = np.argsort(np.arctan2(H[:, 1], H[:, 0]))
    own = [whole(Fraction(H[j, 0]), Fraction(H[j, 1]), Fraction(h[j])) for j in order]
    for a1, a2, b in exact:
        try:
            reach = support(own, (Fraction(a1), Fraction(a2)))
        except ValueError:
            return UNBOUNDED, min(errors)
        errors.append(float(reach / b - 1))
    return max(errors), min(errors)
