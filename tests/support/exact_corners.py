"""Sets of three states in rational arithmetic: every corner, and whether an input steers it."""

from collections.abc import Sequence
from fractions import Fraction

from protocol.arrays import Array

Vector = tuple[Fraction, ...]
Row = tuple[Vector, Fraction]


def rational(H: Array, h: Array) -> list[Row]:
    return [
        (tuple(map(Fraction, map(float, a))), Fraction(float(b))) for a, b in zip(H, h, strict=True)
    ]


def eroded(rows: list[Row], half_widths: Sequence[float]) -> list[Row]:
    w = [Fraction(v) for v in half_widths]
    return [(a, b - sum(abs(v) * c for v, c in zip(a, w, strict=True))) for a, b in rows]


def dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def cross(a: Vector, b: Vector) -> Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def every_corner(rows: list[Row]) -> list[Vector]:
    """All corners of a simple polytope around the origin, from edge to edge."""

    def go(x: Vector, d: Vector, on: frozenset[int]) -> tuple[Vector, frozenset[int]]:
        ahead = [
            ((b - dot(a, x)) / dot(a, d), j)
            for j, (a, b) in enumerate(rows)
            if j not in on and dot(a, d) > 0
        ]
        t, j = min(ahead)
        return tuple(v + t * w for v, w in zip(x, d, strict=True)), on | {j}

    zero, one = Fraction(0), Fraction(1)
    x, on = go((zero,) * 3, (one, Fraction(2, 7), Fraction(3, 11)), frozenset())
    normal = rows[next(iter(on))][0]
    along = (-normal[1], normal[0], zero)
    x, on = go(x, along if any(along) else (one, zero, zero), on)
    i, j = on
    x, on = go(x, cross(rows[i][0], rows[j][0]), on)
    found, todo = {on: x}, [on]
    while todo:
        at = todo.pop()
        for left in at:
            i, j = at - {left}
            d = cross(rows[i][0], rows[j][0])
            if dot(rows[left][0], d) > 0:
                d = tuple(-v for v in d)
            y, new = go(found[at], d, at)
            if new - {left} not in found:
                found[new - {left}] = y
                todo.append(new - {left})
    return list(found.values())


def steers(
    x: Vector, A: Sequence[Sequence[float]], b: Sequence[float], target: list[Row], u: float
) -> bool:
    """Whether an input up to u leads from x into the target."""
    following = [dot(tuple(map(Fraction, row)), x) for row in A]
    low, high = -Fraction(u), Fraction(u)
    for a, bound in target:
        g, room = dot(a, tuple(map(Fraction, b))), bound - dot(a, following)
        if g > 0:
            high = min(high, room / g)
        elif g < 0:
            low = max(low, room / g)
        elif room < 0:
            return False
    return low <= high
