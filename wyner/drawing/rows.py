"""A figure of any sweep's rows: rates and shares over a field, with their 95 % intervals."""

from collections.abc import Sequence
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from runtime.errors import UsageError
from wyner.drawing.style import COLOURS, MARKERS
from wyner.sweeps.grid import FILE, SweepError
from wyner.sweeps.results import fields_in, read_rows, read_table, ready_rows, summarise

Row = dict[str, Any]

RATE: Final = "bits_per_second"
LOGARITHMIC_FROM: Final = 1000.0
"""An x axis whose last value is so many times the first is logarithmic."""

AIR: Final = 0.06
"""Share of the vertical axis beyond what is drawn, so that no curve lies on the frame."""

WORDS: Final = {
    RATE: "message rate (bit/s), which is not secrecy",
    "secret_bits_per_second_at_most": "secret at most (bit/s)",
    "state_cost": "state cost: mean of x'x a step",
    "input_effort": "input effort: mean of u'u a step",
    "agreed": "agreements, share of tested steps",
    "secrecy.alpha": "alpha, size of D_e in D_c",
}
"""Columns as an axis calls them."""


def in_words(column: str) -> str:
    """A column as an axis calls it."""
    if column.endswith((" keys known", " messages read")):
        return f"{column}, share"
    return WORDS.get(column, column)


def ready(path: Path) -> tuple[list[Row], list[str]]:
    """The rows with rates and intervals of a sweep's file, and the fields of its grid."""
    try:
        rows = read_table(path)
        if "runs_by_symbols" in rows[0]:
            rows = read_rows(path)
            fields = fields_in(rows)
            return ready_rows(summarise(rows), fields), fields
    except SweepError as error:
        raise UsageError(error.problems) from None
    names = list(rows[0])
    if "runs" not in names or RATE not in names:
        raise UsageError(f"{path}: expected the rows of `wyner sweep`, or its -rates.csv")
    return rows, names[names.index("variant") + 1 : names.index("runs")]


def longest(rows: Sequence[Row], fields: Sequence[str]) -> str:
    """The field with the most different numbers."""
    if not fields:
        raise UsageError("--plot: the sweep has no grid, expected a field that it varies")

    def numbers(name: str) -> int:
        values = {_number(row[name]) for row in rows}
        return 0 if None in values else len(values)

    return max(fields, key=numbers)


def _number(value: object) -> float | None:
    try:
        return float(str(value))
    except ValueError:
        return None


def draw_rows(
    figure: Figure,
    rows: Sequence[Row],
    fields: Sequence[str],
    x: str,
    ys: Sequence[str],
) -> str:
    """A curve for each column and each setting of the other fields; returns the note."""
    others = [name for name in ("scenario", "variant", *fields) if name != x]
    told = [name for name in others if len({row[name] for row in rows}) > 1]
    if len({row["scenario"] for row in rows}) == len({row.get(FILE) for row in rows}):
        told = [name for name in told if name != FILE]  # the scenario's name says it
    axes = figure.subplots()
    curves: dict[str, list[tuple[float, float, float, float]]] = {}
    for row in rows:
        at = _number(row[x])
        if at is None:
            raise UsageError(f"--plot: {x}: got {row[x]!r}, expected numbers")
        setting = ", ".join(str(row[name]).strip('"') for name in told)
        for y in ys:
            value = _number(row[y])
            if value is None:  # nothing was agreed or delivered there
                continue
            low = _number(row.get(f"{y}_low", row.get(f"{y} low", "")))
            high = _number(row.get(f"{y}_high", row.get(f"{y} high", "")))
            label = " / ".join(part for part in (y if len(ys) > 1 else "", setting) if part)
            ends = (nan if low is None else low, nan if high is None else high)
            curves.setdefault(label, []).append((at, value, *ends))
    for place, (label, points) in enumerate(curves.items()):
        points.sort()
        for one, other in pairwise(points):
            if one[0] == other[0]:
                which = f" of {label}" if label else ""
                raise UsageError(
                    f"--plot: {x}: two points{which} at {one[0]:g}, and nothing in the rows tells "
                    "them apart: sweep them again, or leave one out"
                )
        columns = [list(column) for column in zip(*points, strict=True)]
        colour, marker = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
        axes.fill_between(columns[0], columns[2], columns[3], color=colour, alpha=0.18, lw=0)
        axes.plot(columns[0], columns[1], color=colour, marker=marker, lw=1, label=label or None)
    if any(curves):
        axes.legend()
    places = [point[0] for points in curves.values() for point in points]
    if places and min(places) > 0 and max(places) >= LOGARITHMIC_FROM * min(places):
        axes.set_xscale("log")
    axes.set_xlabel(in_words(x))
    axes.set_ylabel(in_words(ys[0]) if len(ys) == 1 else "share")
    drawn = [v for points in curves.values() for point in points for v in point[1:]]
    shares = all(y == "agreed" or y.endswith((" keys known", " messages read")) for y in ys)
    top = 1.0 if shares else max(drawn, default=0.0)
    top = max([top, *drawn]) or 1.0
    axes.set_ylim(-AIR * top, (1 + AIR) * top)
    runs = sorted({int(row["runs"]) for row in rows})
    shown = str(runs[0]) if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    return (
        f"{shown} runs of {rows[0]['steps']} steps a point; bands: 95 % intervals, where there are "
        "any"
    )
