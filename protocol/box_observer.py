"""Where a state lies that is read through some outputs alone: a box, the same at both ends.

y = C x + n. Both ends have y, the candidates and the decoded index, and so the same box, to the
last bit: every operation rounds outwards by one float, in a fixed order, with no library between.
The plant's own sums round too: x(k+1) and y are not exactly A x + B u + d and C x + n. So D_c and N
are widened by what such a sum may round (:data:`ROUNDING`), and the box holds the state as it is.
The box advances once a transition, from y(k+1) and the offer alone, so that a process that begins
again from the box that it kept goes on with the very same numbers.

Eve has it too. What is possible for Eve is decided by the offer
(:attr:`protocol.agreement.AgreementRule.apart`): a test of Eve's own box would promise too much, as
Eve may wait some steps before naming a symbol.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nextafter
from typing import Final, NamedTuple

from protocol.vectors import Matrix, Vector

SETTLED: Final = 200
"""Readings after which the box of a quiet loop has settled."""

ROUNDING: Final = 2.0**-52
"""Bound of a sum's rounding, as a share of its terms' magnitudes, for each of its terms.

Each operation rounds by half of this share at most. The other half covers the second order.
"""

PASSES: Final = 2
"""How often a box is contracted through the rows of C, and through those of A backwards."""


class Box(NamedTuple):
    """low <= x <= high, by component; shapes (n,)."""

    low: Vector
    high: Vector

    @property
    def radius(self) -> Vector:
        """Half its widths."""
        return tuple((b - a) / 2 for a, b in zip(self.low, self.high, strict=True))

    @property
    def centre(self) -> Vector:
        """Its middle: the controller's estimate of the state."""
        return tuple((a + b) / 2 for a, b in zip(self.low, self.high, strict=True))


Interval = tuple[float, float]


def _add(one: Interval, other: Interval) -> Interval:
    return nextafter(one[0] + other[0], -inf), nextafter(one[1] + other[1], inf)


def _subtract(one: Interval, other: Interval) -> Interval:
    return nextafter(one[0] - other[1], -inf), nextafter(one[1] - other[0], inf)


def _scaled(factor: float, one: Interval) -> Interval:
    if factor == 0:
        return 0.0, 0.0
    low, high = (factor * v for v in (one if factor > 0 else one[::-1]))
    return nextafter(low, -inf), nextafter(high, inf)


def _divided(one: Interval, factor: float) -> Interval:
    low, high = (v / factor for v in (one if factor > 0 else one[::-1]))
    return nextafter(low, -inf), nextafter(high, inf)


def _total(terms: Sequence[Interval]) -> Interval:
    """The sum, from the left."""
    total = (0.0, 0.0)
    for term in terms:
        total = _add(total, term)
    return total


def _rounding(row: Sequence[float], box: Sequence[Interval], rest: float, terms: int) -> float:
    """What a sum of ``row`` x and of ``terms`` others may round, for an x in the box.

    ``rest`` is the others' magnitude, all together.
    """
    total = rest
    for a, (low, high) in zip(row, box, strict=True):
        total += abs(a) * max(-low, high)
    return (len(row) + terms) * ROUNDING * total


def _contracted(
    row: Sequence[float], box: list[Interval], within: Interval
) -> list[Interval] | None:
    """The part of ``box`` where row x may be ``within``; None where it is nowhere."""
    terms = [_scaled(a, part) for a, part in zip(row, box, strict=True)]
    out = list(box)
    for j, a in enumerate(row):
        if a == 0:
            continue
        others = _total([t for i, t in enumerate(terms) if i != j])
        low, high = _divided(_subtract(within, others), a)
        low, high = max(low, out[j][0]), min(high, out[j][1])
        if low > high:
            return None
        out[j] = (low, high)
        terms[j] = _scaled(a, out[j])
    return out


class Observed(NamedTuple):
    """What a transition tells: the candidates that explain it, and the box after it."""

    possible: tuple[int, ...]
    box: Box


class Estimate(NamedTuple):
    """What both ends keep of a transition: the box right after it, and what may be in force."""

    box: Box
    inputs: tuple[Vector, ...]


@dataclass(frozen=True, slots=True)
class BoxObserver:
    """The box of a plant x+ = A x + B u + d, y = C x + n.

    Parameters
    ----------
    A, B, C : tuple of tuple of float, shapes (n, n), (n, m) and (r, n)
    disturbance : tuple of float, shape (n,)
        Half-widths of D_c.
    noise : tuple of float, shape (r,)
        Half-widths of N, of the outputs.
    bounds : tuple of float, shape (n,)
        Half-widths of what the state never leaves: where the box begins.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    disturbance: Vector
    noise: Vector
    bounds: Vector

    def begin(self, y: Sequence[float]) -> Box:
        """The box of a first reading, or of one that no candidate explains."""
        whole = [(-b, b) for b in self.bounds]
        return _box(self._met(whole, y) or whole)

    def moved(self, box: Box, inputs: Sequence[Sequence[float]]) -> Box:
        """The box a step later, with one of ``inputs`` in force and nothing read."""
        parts = list(zip(box.low, box.high, strict=True))
        found = []
        for u in inputs:
            pushes = self._pushes(parts, u)
            found.append(
                [
                    _add(_total([_scaled(a, x) for a, x in zip(row, parts, strict=True)]), push)
                    for row, push in zip(self.A, pushes, strict=True)
                ]
            )
        return _hull(found)

    def met(self, box: Box, y: Sequence[float]) -> Box:
        """The part of a box that may be read as ``y``; where there is none it begins anew."""
        found = self._met(list(zip(box.low, box.high, strict=True)), y)
        return self.begin(y) if found is None else _box(found)

    def step(
        self, box: Box, candidates: Sequence[Sequence[float]], y_next: Sequence[float]
    ) -> Observed:
        """Follow a transition: whatever explains y(k+1) stays, and the box is their hull.

        A missed step is one with a single candidate, the fallback's input.
        """
        possible, found = [], []
        for i, u in enumerate(candidates):
            after = self._after(box, u, y_next)
            if after is not None:
                possible.append(i)
                found.append(after)
        if not found:
            return Observed((), self.begin(y_next))
        return Observed(tuple(possible), _hull(found))

    def _pushes(self, box: Sequence[Interval], u: Sequence[float]) -> list[Interval]:
        """B u + D_c, and what the plant's sum A x + B u + d rounds for an x in the box."""
        pushes = []
        for row_a, row_b, width in zip(self.A, self.B, self.disturbance, strict=True):
            terms = [b * v for b, v in zip(row_b, u, strict=True)]
            rest = sum(map(abs, terms)) + width
            w = width + _rounding(row_a, box, rest, len(terms) + 1)
            pushes.append(
                _add(_total([_scaled(b, (v, v)) for b, v in zip(row_b, u, strict=True)]), (-w, w))
            )
        return pushes

    def _after(
        self, box: Box, u: Sequence[float], y_next: Sequence[float]
    ) -> list[Interval] | None:
        """The box after one candidate; None where y(k+1) rules it out."""
        parts = list(zip(box.low, box.high, strict=True))
        before: list[Interval] | None = parts
        pushes = self._pushes(parts, u)
        after: list[Interval] | None = None
        for _ in range(PASSES):
            assert before is not None
            moved = [
                _add(_total([_scaled(a, x) for a, x in zip(row, before, strict=True)]), push)
                for row, push in zip(self.A, pushes, strict=True)
            ]
            after = self._met(moved, y_next)
            if after is None:
                return None
            for row, push, there in zip(self.A, pushes, after, strict=True):
                before = _contracted(row, before, _subtract(there, push))
                if before is None:
                    return None
        return after

    def _met(self, box: list[Interval], y: Sequence[float]) -> list[Interval] | None:
        """The part of a box that may be read as ``y``."""
        out: list[Interval] | None = box
        widths = [
            width + _rounding(row, box, width, 1)
            for row, width in zip(self.C, self.noise, strict=True)
        ]
        for _ in range(PASSES):
            for row, value, width in zip(self.C, y, widths, strict=True):
                within = (nextafter(value - width, -inf), nextafter(value + width, inf))
                out = _contracted(row, out or [], within)
                if out is None:
                    return None
        return out

    def needed(self, box: Box, u: Sequence[float]) -> tuple[Vector, Vector]:
        """abs(C B u), and 2 rad(C A X + C D_c + N): the first must be larger, in some output.

        So far apart must candidates that differ by ``u`` lead, to be told apart in every case.
        """
        moved = tuple(
            abs(sum(c * sum(b * v for b, v in zip(row, u, strict=True)) for c, row in terms))
            for terms in ([*zip(line, self.B, strict=True)] for line in self.C)
        )
        return moved, tuple(2 * reach for reach in self.reach(box))

    def reach(self, box: Box) -> Vector:
        """rad(C A X + C D_c + N): how far from its prediction the next reading may be."""
        out = []
        for line, width in zip(self.C, self.noise, strict=True):
            total = width
            for column, radius in zip(zip(*self.A, strict=True), box.radius, strict=True):
                total += abs(sum(a * c for a, c in zip(column, line, strict=True))) * radius
            for c, w in zip(line, self.disturbance, strict=True):
                total += abs(c) * w
            out.append(total)
        return tuple(out)

    def read(self, x: Sequence[float]) -> Vector:
        """C x, products added from the left."""
        out = []
        for line in self.C:
            total = line[0] * x[0]
            for j in range(1, len(line)):
                total += line[j] * x[j]
            out.append(total)
        return tuple(out)

    def quiet(self) -> Vector:
        """Half-widths of the box of a loop whose every input is decoded: at most these, in the end.

        Where each reading is the one expected a box shrinks least.
        """
        nothing, zero = self.read((0.0,) * len(self.A)), (0.0,) * len(self.B[0])
        box = self.begin(nothing)
        for _ in range(SETTLED):
            box = self.step(box, (zero,), nothing).box
        return box.radius


def _hull(found: Sequence[Sequence[Interval]]) -> Box:
    """The smallest box around some."""
    sides = range(len(found[0]))
    low = tuple(min(part[j][0] for part in found) for j in sides)
    high = tuple(max(part[j][1] for part in found) for j in sides)
    return Box(low, high)


def _box(parts: Sequence[Interval]) -> Box:
    return Box(tuple(p[0] for p in parts), tuple(p[1] for p in parts))
