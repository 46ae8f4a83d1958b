"""Charts as inline SVG, drawn by hand: a page must not need a library to be looked at."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

Points = Sequence[tuple[float, float]]

WIDTH: Final = 760
CHART_HEIGHT: Final = 240
LEFT, RIGHT, TOP, BOTTOM = 56, 16, 12, 40
MOST_POINTS: Final = 1500
"""Points of a line; of longer ones the extremes of so many stretches are drawn."""

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555")
DASHES: Final = ("", "6 3", "2 3", "8 3 2 3", "1 4", "10 4", "4 2")
"""Colour is never the only signal."""


DENSE: Final = 600
"""Points from which a line that goes up and down is a smear: its range is drawn instead."""

COLUMNS: Final = 170
"""Stretches of such a range: four pixels each."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of a chart; ``steps`` draws it as a staircase, ``place`` chooses colour and dashes.

    ``banded`` says that a long one is drawn as the range of its values.
    """

    label: str
    points: Points
    place: int = 0
    steps: bool = False
    banded: bool = False


@dataclass(frozen=True, slots=True)
class Mark:
    """A short tick at the foot of the chart."""

    x: float


@dataclass(frozen=True, slots=True)
class Flag:
    """A line from top to foot with a word beside it."""

    x: float
    label: str


def ticks(low: float, high: float, about: int = 6) -> list[float]:
    """Round numbers from ``low`` to ``high``, about so many."""
    span = high - low
    if not span > 0 or not math.isfinite(span):
        return [low]
    raw = span / about
    size = 10.0 ** math.floor(math.log10(raw))
    step = next((s * size for s in (1, 2, 2.5, 5) if s * size >= raw), 10 * size)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]


def band(points: Points) -> Points:
    """The outline of what a long line covers: the highest of each stretch, then the lowest."""
    x = [p[0] for p in points]
    low, span = x[0], max(x[-1] - x[0], 1e-300)
    top: dict[int, tuple[float, float]] = {}
    foot: dict[int, tuple[float, float]] = {}
    for point in points:
        column = min(int(COLUMNS * (point[0] - low) / span), COLUMNS - 1)
        top[column] = max(top.get(column, point), point, key=_second)
        foot[column] = min(foot.get(column, point), point, key=_second)
    middle = [low + span * (column + 0.5) / COLUMNS for column in top]
    upper = [(at, p[1]) for at, p in zip(middle, top.values(), strict=True)]
    lower = [(at, p[1]) for at, p in zip(middle, foot.values(), strict=True)]
    return [*upper, *reversed(lower)]


class Series:
    """Points of a line as they come; of a long one the extremes of each stretch are kept.

    There are at most two for each of :data:`MOST_POINTS` stretches, and every peak is among them.
    """

    def __init__(self, points: Iterable[tuple[float, float]] = ()) -> None:
        self._stretches: list[tuple[tuple[float, float], tuple[float, float]]] = []
        self._length = 1
        self._open = 0
        for point in points:
            self.add(*point)

    def add(self, x: float, y: float) -> None:
        """Take the next point."""
        point = x, y
        if self._open and self._stretches:
            self._stretches[-1] = _extremes(self._stretches[-1], (point, point))
        else:
            self._stretches.append((point, point))
        self._open = (self._open + 1) % self._length
        if not self._open and len(self._stretches) > MOST_POINTS:
            pairs = self._stretches
            self._stretches = [_extremes(*pairs[i : i + 2]) for i in range(0, len(pairs) - 1, 2)]
            self._length *= 2
            if len(pairs) % 2:
                self._stretches.append(pairs[-1])
                self._open = self._length // 2

    def points(self) -> Points:
        """What is kept, in order."""
        return [p for stretch in self._stretches for p in sorted(set(stretch))]


def _extremes(
    one: tuple[tuple[float, float], tuple[float, float]],
    other: tuple[tuple[float, float], tuple[float, float]],
) -> tuple[tuple[float, float], tuple[float, float]]:
    return min(one[0], other[0], key=_second), max(one[1], other[1], key=_second)


def _second(point: tuple[float, float]) -> float:
    return point[1]


def number(value: float) -> str:
    """Pixels, to two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


@dataclass(frozen=True, slots=True)
class PlotFrame:
    """The plotting area and the ranges shown in it."""

    x: tuple[float, float]
    y: tuple[float, float]
    height: int

    @classmethod
    def about(
        cls, points: Iterable[tuple[float, float]], height: int, *, equal: bool = False
    ) -> "PlotFrame":
        """A frame about all points with a little air; ``equal`` gives both axes one scale."""
        shown = [p for p in points if math.isfinite(p[0]) and math.isfinite(p[1])] or [(0.0, 0.0)]
        x = _range([p[0] for p in shown], air=0.04 if equal else 0.0)
        y = _range([p[1] for p in shown], air=0.06)
        if equal:
            wide, high = WIDTH - LEFT - RIGHT, height - TOP - BOTTOM
            scale = max((x[1] - x[0]) / wide, (y[1] - y[0]) / high)
            x = _widened(x, scale * wide)
            y = _widened(y, scale * high)
        return cls(x, y, height)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of a point."""
        wide, high = WIDTH - LEFT - RIGHT, self.height - TOP - BOTTOM
        return (
            LEFT + (x - self.x[0]) / (self.x[1] - self.x[0]) * wide,
            TOP + (self.y[1] - y) / (self.y[1] - self.y[0]) * high,
        )

    def path(self, points: Iterable[tuple[float, float]], *, steps: bool = False) -> str:
        """The points as the ``d`` of a path."""
        out: list[str] = []
        for x, y in (self.at(*p) for p in points):
            if steps and out:
                out.append(f"H{number(x)}V{number(y)}")
            else:
                out.append(f"{'L' if out else 'M'}{number(x)} {number(y)}")
        return "".join(out)

    def axes(self, x_label: str, y_label: str) -> list[str]:
        """Grid, numbers and labels."""
        out = []
        right, foot = WIDTH - RIGHT, self.height - BOTTOM
        for v in ticks(*self.x):
            px = number(self.at(v, self.y[0])[0])
            out.append(f'<path class="grid" d="M{px} {TOP}V{foot}"/>')
            out.append(f'<text x="{px}" y="{foot + 15}" text-anchor="middle">{v:g}</text>')
        for v in ticks(*self.y, about=4):
            py = self.at(self.x[0], v)[1]
            out.append(f'<path class="grid" d="M{LEFT} {number(py)}H{right}"/>')
            out.append(f'<text x="{LEFT - 6}" y="{number(py + 4)}" text-anchor="end">{v:g}</text>')
        middle = (TOP + foot) / 2
        out.append(
            f'<text x="{(LEFT + right) / 2}" y="{self.height - 6}" text-anchor="middle">'
            f"{escape(x_label)}</text>"
        )
        out.append(
            f'<text transform="translate(12 {middle}) rotate(-90)" text-anchor="middle">'
            f"{escape(y_label)}</text>"
        )
        return out


def _range(values: Sequence[float], *, air: float) -> tuple[float, float]:
    low, high = min(values), max(values)
    if low == high:
        low, high = low - 0.5, high + 0.5
    more = air * (high - low)
    return low - more, high + more


def _widened(span: tuple[float, float], to: float) -> tuple[float, float]:
    middle = (span[0] + span[1]) / 2
    return middle - to / 2, middle + to / 2


def svg(title: str, height: int, parts: Iterable[str]) -> str:
    """The parts as one picture with a title for those who cannot see it."""
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{''.join(parts)}</svg>"
    )


def chart(
    title: str,
    lines: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    marks: Iterable[Mark] = (),
    flags: Iterable[Flag] = (),
    floor: float | None = None,
) -> str:
    """Lines over time with a legend.

    Parameters
    ----------
    title : str
    lines : sequence of Line
    x_label, y_label : str
    marks : iterable of Mark
        Those of one place are drawn once.
    flags : iterable of Flag
    floor : float, optional
        A value that the vertical axis shows in any case.
    """
    points = [p for line in lines for p in line.points]
    if floor is not None and points:
        points.append((points[0][0], floor))
    frame = PlotFrame.about(points, CHART_HEIGHT)
    parts = frame.axes(x_label, y_label)
    for line in lines:
        if len(line.points) > DENSE and line.banded:
            d = frame.path(band(line.points))
            colour = COLOURS[line.place % len(COLOURS)]
            parts.append(f'<path class="band" fill="{colour}" d="{d}Z"/>')
        else:
            d = frame.path(line.points, steps=line.steps)
            parts.append(f'<path class="line" {_look(line.place)} d="{d}"/>')
    foot = CHART_HEIGHT - BOTTOM
    places = dict.fromkeys(number(frame.at(m.x, 0.0)[0]) for m in marks)
    ticked = "".join(f"M{x} {foot}v-7" for x in places)
    if ticked:
        parts.append(f'<path class="mark" d="{ticked}"/>')
    for place, flag in enumerate(flags):
        x = frame.at(flag.x, 0.0)[0]
        parts.append(f'<path class="flag" d="M{number(x)} {TOP}V{foot}"/>')
        at = f'x="{number(x + 3)}" y="{TOP + 10 + 13 * place}"'
        parts.append(f"<text {at}>{escape(flag.label)}</text>")
    return svg(title, CHART_HEIGHT, parts) + legend([(x.label, x.place) for x in lines])


def legend(entries: Sequence[tuple[str, int]]) -> str:
    """A line of samples with their labels."""
    out = []
    for label, place in entries:
        sample = (
            f'<svg class="sample" viewBox="0 0 28 8" aria-hidden="true">'
            f'<path class="line" {_look(place)} d="M0 4H28"/></svg>'
        )
        out.append(f"<span>{sample} {escape(label)}</span>")
    return f'<p class="legend">{" ".join(out)}</p>'


def _look(place: int) -> str:
    colour, dashes = COLOURS[place % len(COLOURS)], DASHES[place % len(DASHES)]
    return f'stroke="{colour}"' + (f' stroke-dasharray="{dashes}"' if dashes else "")
