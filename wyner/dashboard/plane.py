"""The agreement picture: the paper's Fig. 4 for one real step, in characters.

Around each centre c_i = A x + B u_i stands the outline of D_c (solid); a mark shows where x(k+1)
fell. The frame is as wide as these need. D_e = alpha D_c (dotted) is often many times wider: what
leaves the frame ends in arrows at its sides. With more than two states the sets are projected on
the two axes along which the candidates lie furthest apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import isfinite
from typing import Final, Literal

from protocol.agreement import Gauge
from protocol.convex import corners
from protocol.messages import PlantModel, PlantStatus
from protocol.vectors import Matrix, Vector
from wyner.dashboard.text import symbol_of

Kind = Literal["", "eavesdropper", "defender", "centre", "next"]
Point = tuple[float, float]

MARGIN: Final = 0.06
"""Share of the frame that is left free around what is drawn."""

_BRAILLE: Final = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))


@dataclass(frozen=True, slots=True)
class Cell:
    """One character of the picture and what it belongs to."""

    character: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Axes:
    """The two state components drawn, counted from 0: across and up; up is -1 for n = 1."""

    across: int
    up: int

    @property
    def words(self) -> str:
        """The axes as a reader counts them."""
        up = f", vertical x{self.up + 1}" if self.up >= 0 else ""
        return f"horizontal x{self.across + 1}{up}"

    @property
    def short(self) -> str:
        """The same in fewer characters."""
        across = f"x{self.across + 1}"
        return f"x{self.up + 1} against {across}" if self.up >= 0 else across


def axes_of(B: Matrix, H: Matrix, h: Vector) -> Axes:
    """The axes along which an input moves the state furthest, measured in widths of D_c."""
    width = [_reach(H, h, i) for i in range(len(B))]
    moved = [sum(abs(b) for b in row) / w for row, w in zip(B, width, strict=True)]
    order = sorted(range(len(B)), key=lambda i: (-moved[i], i))
    return Axes(order[0], order[1] if len(order) > 1 else -1)


def _reach(H: Matrix, h: Vector, axis: int) -> float:
    """Distance from the origin to the edge of the set along one axis (a section, not a shadow)."""
    edges = [b / row[axis] for row, b in zip(H, h, strict=True) if row[axis] > 0]
    return min(edges, default=1.0)


def verdict(status: PlantStatus) -> str:
    """What the agreement test said of the pictured step, in words (equation 20)."""
    symbol = status.pictured_symbol
    if symbol >= 0:
        return f"KEY {symbol}: only input {symbol} explains it"
    inside = status.pictured_inside
    if inside == 0:
        return "no key: no input explains it"
    if inside > 1:
        return f"no key: {inside} inputs explain it"
    return "no key: outside a D_e, so she knows"


def fits(model: PlantModel, status: PlantStatus) -> bool:
    """Whether the pictured step can be one of this model's; another plant may have spoken."""
    states, inputs = len(model.A), len(model.B[0])
    return len(status.pictured_x) == states and all(
        len(u) == inputs for u in status.pictured_candidates
    )


def draw(model: PlantModel, status: PlantStatus, width: int, height: int) -> list[list[Cell]]:
    """The pictured transition, which fits the model, as ``height`` rows of ``width`` cells.

    Blank before the first one, and where it is too far out for a float to span.
    """
    blank = [[Cell(" ", "")] * width for _ in range(height)]
    if status.pictured_k < 0 or not status.pictured_candidates or width < 4 or height < 2:
        return blank
    axes = axes_of(model.B, model.defender_H, model.defender_h)
    shape = outline(model.defender_H, model.defender_h, axes)
    predictions = [
        _project(_centre(model.A, model.B, status.pictured_x, u), axes)
        for u in status.pictured_candidates
    ]
    fallen = _project(status.pictured_x_next, axes)
    if model.eavesdropper_H:
        wide = list(outline(model.eavesdropper_H, model.eavesdropper_h, axes))
    else:
        wide = [(model.alpha * a, model.alpha * b) for a, b in shape]
    points = [(c[0] + p[0], c[1] + p[1]) for c in predictions for p in shape] + [fallen]
    if not isfinite(sum(abs(v) for point in points for v in point)):
        return blank
    canvas = _Canvas(width, height, points)
    for c in predictions:
        canvas.polygon([(c[0] + a, c[1] + b) for a, b in wide], "eavesdropper")
    for c in predictions:
        canvas.polygon([(c[0] + a, c[1] + b) for a, b in shape], "defender")
    canvas.mark(fallen, "●", "next")
    for i, c in enumerate(predictions):
        name = symbol_of(i, len(predictions))
        canvas.mark(c, name if len(name) == 1 else "+", "centre")
    spread = max(abs(a) for a, _ in wide)
    leaves_left = min(c[0] for c in predictions) - spread
    leaves_right = max(c[0] for c in predictions) + spread
    canvas.arrows(leaves_left, leaves_right, "◀▶")
    return canvas.rows()


def spread(model: PlantModel) -> float:
    """How many times D_c must be scaled to hold D_e: alpha, where it has no shape of its own."""
    if not model.eavesdropper_H:
        return model.alpha
    farthest = 0.0
    for v in _vertices(model.eavesdropper_H, model.eavesdropper_h):
        for row, edge in zip(model.defender_H, model.defender_h, strict=True):
            farthest = max(farthest, sum(a * b for a, b in zip(row, v, strict=True)) / edge)
    return farthest or model.alpha


def _centre(A: Matrix, B: Matrix, x: Vector, u: Vector) -> Vector:
    return tuple(
        sum(a * v for a, v in zip(row, x, strict=True))
        + sum(b * v for b, v in zip(column, u, strict=True))
        for row, column in zip(A, B, strict=True)
    )


def _project(x: Sequence[float], axes: Axes) -> Point:
    return (x[axes.across], x[axes.up] if axes.up >= 0 else 0.0)


@lru_cache(maxsize=8)
def outline(H: Matrix, h: Vector, axes: Axes) -> tuple[Point, ...]:
    """Corners, in order, of the shadow of { v : H v <= h } on two axes."""
    found = {_project(v, axes) for v in _vertices(H, h)}
    if axes.up < 0:
        ends = [p[0] for p in found]
        return ((min(ends), -1.0), (max(ends), -1.0), (max(ends), 1.0), (min(ends), 1.0))
    return _hull(found)


@lru_cache(maxsize=8)
def _vertices(H: Matrix, h: Vector) -> tuple[Vector, ...]:
    """Corners of { v : H v <= h }: of a box, or of a set with at most four states; else of a box
    about as wide.
    """
    n = len(H[0])
    widths = Gauge.from_rows(H, h).half_widths
    if widths is None and n <= 4:
        return tuple(map(tuple, corners(H, h).tolist()))
    widths = widths or tuple(_reach(H, h, i) for i in range(n))
    return tuple(product(*((-w, w) for w in widths)))


def _hull(points: set[Point]) -> tuple[Point, ...]:
    """Convex hull, anticlockwise (monotone chain)."""
    ordered = sorted(points)

    def chain(sequence: Sequence[Point]) -> list[Point]:
        kept: list[Point] = []
        for p in sequence:
            while len(kept) >= 2 and _turn(kept[-2], kept[-1], p) <= 0:
                kept.pop()
            kept.append(p)
        return kept[:-1]

    return tuple(chain(ordered) + chain(ordered[::-1]))


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


class _Canvas:
    """A grid of cells, each two dots wide and four high."""

    def __init__(self, width: int, height: int, points: Sequence[Point]) -> None:
        self._width, self._height = width, height
        self._columns, self._lines = width * 2, height * 4
        xs, ys = [p[0] for p in points], [p[1] for p in points]
        wider, higher = ((max(v) * MARGIN - min(v) * MARGIN) for v in (xs, ys))
        self._left, self._right = min(xs) - wider, max(xs) + wider
        self._bottom, self._top = min(ys) - higher, max(ys) + higher
        self._dots: dict[tuple[int, int], Kind] = {}
        self._marks: dict[tuple[int, int], Cell] = {}

    def _dot(self, p: Point) -> tuple[int, int]:
        across = (p[0] - self._left) / ((self._right - self._left) or 1.0)
        up = (p[1] - self._bottom) / ((self._top - self._bottom) or 1.0)
        return round(across * (self._columns - 1)), round((1 - up) * (self._lines - 1))

    def polygon(self, corners: Sequence[Point], kind: Kind) -> None:
        """Draw what the frame holds of a closed outline; that of the eavesdropper is dotted."""
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            inside = self._clipped(a, b)
            if inside is None:
                continue
            (ax, ay), (bx, by) = map(self._dot, inside)
            steps = max(abs(bx - ax), abs(by - ay), 1)
            for i in range(steps + 1):
                dot = (round(ax + (bx - ax) * i / steps), round(ay + (by - ay) * i / steps))
                if kind == "defender" or sum(dot) % 2 == 0:
                    self._dots[dot] = kind

    def _clipped(self, a: Point, b: Point) -> tuple[Point, Point] | None:
        """The part of a line that lies in the frame (Liang and Barsky), if any."""
        begin, end = 0.0, 1.0
        dx, dy = b[0] - a[0], b[1] - a[1]
        for step, room in (
            (-dx, a[0] - self._left),
            (dx, self._right - a[0]),
            (-dy, a[1] - self._bottom),
            (dy, self._top - a[1]),
        ):
            if step == 0:
                if room < 0:
                    return None
            elif step < 0:
                begin = max(begin, room / step)
            else:
                end = min(end, room / step)
        if begin > end:
            return None
        return (
            (a[0] + begin * dx, a[1] + begin * dy),
            (a[0] + end * dx, a[1] + end * dy),
        )

    def mark(self, p: Point, character: str, kind: Kind) -> None:
        """Put one character where a point lies, or beside it where another one stands."""
        x, y = self._dot(p)
        column, line = x // 2, y // 4
        for step in (0, 1, -1, 2, -2):
            place = (column + step, line)
            if 0 <= place[0] < self._width and place not in self._marks:
                self._marks[place] = Cell(character, kind)
                return

    def arrows(self, left: float, right: float, characters: str) -> None:
        """Say at the frame's sides that the eavesdropper's sets go on beyond them."""
        middle = self._height // 2
        if left < self._left:
            self._marks.setdefault((0, middle), Cell(characters[0], "eavesdropper"))
        if right > self._right:
            end = (self._width - 1, middle)
            self._marks.setdefault(end, Cell(characters[1], "eavesdropper"))

    def rows(self) -> list[list[Cell]]:
        """The picture, top row first."""
        return [[self._cell(x, y) for x in range(self._width)] for y in range(self._height)]

    def _cell(self, x: int, y: int) -> Cell:
        if (x, y) in self._marks:
            return self._marks[x, y]
        bits, kinds = 0, set()
        for row, pair in enumerate(_BRAILLE):
            for column, bit in enumerate(pair):
                dot = self._dots.get((2 * x + column, 4 * y + row))
                if dot is not None:
                    bits |= bit
                    kinds.add(dot)
        if not bits:
            return Cell(" ", "")
        return Cell(chr(0x2800 + bits), "defender" if "defender" in kinds else "eavesdropper")
