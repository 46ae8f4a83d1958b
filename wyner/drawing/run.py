"""The figures of a run's report: each is drawn on axes that it is given."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

Values = NDArray[Any]

LONG: Final = 2000
"""Values beyond which a line that goes up and down is a smear: its range is drawn instead."""

DASHES: Final = ("-", "--", ":", "-.")
"""Colour is never the only signal."""

STRETCHES: Final = 300
"""Stretches of such a range, and of a long count."""


def draw_over_time(
    axes: Axes,
    time_s: Values,
    lines: Mapping[str, Values],
    *,
    agreed_s: Values,
    flags: Sequence[tuple[float, str]],
    held: bool = False,
) -> None:
    """Quantities of the loop over plant time.

    Parameters
    ----------
    axes : Axes
    time_s : array, shape (steps,)
    lines : mapping of str to array
    agreed_s : array
        When key symbols were agreed, marked at the foot.
    flags : sequence of (float, str)
        Vertical lines with a word beside them.
    held : bool
        Whether a value holds until the next step, as an input does.
    """
    for (label, values), dashes in zip(lines.items(), cycle(DASHES), strict=False):
        if len(values) > LONG:
            starts = np.linspace(0, len(values), STRETCHES, endpoint=False).astype(int)
            low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
            axes.fill_between(time_s[starts], low, high, step="post", alpha=0.4, label=label)
        else:
            style = "steps-post" if held else "default"
            axes.plot(time_s, values, lw=1, ls=dashes, drawstyle=style, label=label)
    ticks = agreed_s[_spread(len(agreed_s))]
    foot = axes.get_xaxis_transform()
    axes.plot(ticks, np.zeros(len(ticks)), "|", color="k", ms=8, transform=foot, clip_on=False)
    for row, (at, label) in enumerate(flags):
        axes.axvline(at, color="k", lw=0.8, ls=":")
        axes.text(at, 0.97 - 0.07 * row, f" {label}", transform=foot, va="top")
    axes.set_xlabel("plant time (s)")
    axes.legend()


def draw_keys(axes: Axes, agreed_s: Values, right: Mapping[str, NDArray[np.bool_]]) -> None:
    """Key symbols that were agreed so far, and those of them that each eavesdropper got right.

    Parameters
    ----------
    axes : Axes
    agreed_s : array, shape (keys,)
        When each was agreed, in order.
    right : mapping of str to array, shape (keys,)
    """
    shown = _spread(len(agreed_s))
    everybody = {"agreed by both ends": np.ones(len(agreed_s), np.bool_)}
    lines = {**everybody, **right}
    for (label, mine), dashes in zip(lines.items(), cycle(DASHES), strict=False):
        count = np.cumsum(mine)[shown]
        axes.step(agreed_s[shown], count, where="post", lw=1, ls=dashes, label=label)
    axes.set_xlabel("plant time (s)")
    axes.set_ylabel("key symbols")
    axes.set_ylim(bottom=0)
    axes.legend()


def _spread(count: int) -> NDArray[np.int64]:
    """Places evenly over so many, the last among them; no more than can be told apart."""
    return np.unique(np.linspace(0, count - 1, min(count, LONG)).astype(np.int64))
