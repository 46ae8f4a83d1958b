"""Charts as inline SVG, drawn by hand: a page must not need a library to be looked at."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

Points = Sequence[tuple[float, float]]

WIDTH: Final = 760
CHART_HEIGHT: Final = 240
PLANE_HEIGHT: Final = 380
LEFT, RIGHT, TOP, BOTTOM = 56, 16, 12, 40
MOST_POINTS: Final = 1500
"""Points of a line; longer ones are thinned to the extremes of each stretch."""

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555")
DASHES: Final = ("", "6 3", "2 3", "8 3 2 3", "1 4", "10 4", "4 2")
"""Colour is never the only signal."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of a chart; ``steps`` draws it as a staircase, ``place`` chooses colour and dashes."""

    label: str
    points: Points
    place: int = 0
    steps: bool = False


@dataclass(frozen=True, slots=True)
class Mark:
    """A short tick at the foot of the chart."""

    x: float


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


def thinned(points: Points) -> Points:
    """At most :data:`MOST_POINTS` points that keep every peak."""
    if len(points) <= MOST_POINTS:
        return points
    stretch = math.ceil(2 * len(points) / MOST_POINTS)
    out: list[tuple[float, float]] = []
    for i in range(0, len(points), stretch):
        part = points[i : i + stretch]
        out += sorted({min(part, key=_second), max(part, key=_second)})
    return out


def _second(point: tuple[float, float]) -> float:
    return point[1]


def _number(value: float) -> str:
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
                out.append(f"H{_number(x)}V{_number(y)}")
            else:
                out.append(f"{'L' if out else 'M'}{_number(x)} {_number(y)}")
        return "".join(out)

    def axes(self, x_label: str, y_label: str) -> list[str]:
        """Grid, numbers and labels."""
        out = []
        right, foot = WIDTH - RIGHT, self.height - BOTTOM
        for v in ticks(*self.x):
            px = _number(self.at(v, self.y[0])[0])
            out.append(f'<path class="grid" d="M{px} {TOP}V{foot}"/>')
            out.append(f'<text x="{px}" y="{foot + 15}" text-anchor="middle">{v:g}</text>')
        for v in ticks(*self.y, about=4):
            py = self.at(self.x[0], v)[1]
            out.append(f'<path class="grid" d="M{LEFT} {_number(py)}H{right}"/>')
            out.append(f'<text x="{LEFT - 6}" y="{_number(py + 4)}" text-anchor="end">{v:g}</text>')
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
    marks: Sequence[Mark] = (),
    floor: float | None = None,
) -> str:
    """Lines over time with a legend.

    Parameters
    ----------
    title : str
    lines : sequence of Line
    x_label, y_label : str
    marks : sequence of Mark
    floor : float, optional
        A value that the vertical axis shows in any case.
    """
    points = [p for line in lines for p in line.points]
    if floor is not None and points:
        points.append((points[0][0], floor))
    frame = PlotFrame.about(points, CHART_HEIGHT)
    parts = frame.axes(x_label, y_label)
    for line in lines:
        d = frame.path(thinned(line.points), steps=line.steps)
        parts.append(f'<path class="line" {_look(line.place)} d="{d}"/>')
    foot = CHART_HEIGHT - BOTTOM
    ticked = "".join(f"M{_number(frame.at(m.x, 0.0)[0])} {foot}v-7" for m in marks)
    if ticked:
        parts.append(f'<path class="mark" d="{ticked}"/>')
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


def plane(
    title: str,
    rings: Sequence[tuple[str, Points, int]],
    star: tuple[float, float],
    labels: tuple[str, str],
) -> str:
    """Closed outlines in the plane, both axes to one scale, and a star."""
    points = [p for _, ring, _ in rings for p in ring]
    frame = PlotFrame.about([*points, star], PLANE_HEIGHT, equal=True)
    parts = frame.axes(*labels)
    for _, ring, place in rings:
        parts.append(f'<path class="line" {_look(place)} d="{frame.path(ring)}Z"/>')
    x, y = frame.at(*star)
    parts.append(f'<path class="star" d="{_star(x, y)}"/>')
    entries = [(label, place) for label, _, place in rings]
    return svg(title, PLANE_HEIGHT, parts) + legend(entries)


def _star(x: float, y: float) -> str:
    corner: Callable[[int], str] = lambda i: (  # noqa: E731
        f"{_number(x + (7 if i % 2 == 0 else 3) * math.sin(math.pi * i / 5))} "
        f"{_number(y - (7 if i % 2 == 0 else 3) * math.cos(math.pi * i / 5))}"
    )
    return "M" + "L".join(corner(i) for i in range(10)) + "Z"
