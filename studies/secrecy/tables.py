"""The tables of docs/findings.md, from the rows of the secrecy studies."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from protocol.statistics import CONFIDENCE, Interval, wilson
from studies.registry import Lines, Row, table
from wyner.runs.score.report import over_runs, percent
from wyner.runs.score.score import Proportion


def share_of(rows: Sequence[Row], right: str, of: str) -> Interval:
    """A share over runs with its interval."""
    return over_runs([Proportion(float(r[right]), int(r[of])) for r in rows])


def exact_of(rows: Sequence[Row]) -> Interval:
    """Share of runs whose message was had whole and exact, of those in which the plant had it."""
    return share_of(rows, "messages_exact", "messages")


@table("ladder", "findings", "secrecy-ladder")
@table("learning", "findings", "secrecy-learning")
def by_tap(rows: Sequence[Row]) -> Lines:
    """One line a condition and eavesdropper."""
    conditions = list(dict.fromkeys(r["condition"] for r in rows))
    found = dict.fromkeys((r["condition"], r["tap"]) for r in rows)
    groups = sorted(found, key=lambda group: conditions.index(group[0]))  # stable by tap
    lines: list[tuple[str, ...]] = [
        (
            "condition", "tap", "runs", "key symbols", "first 200", "bits", "messages", "list",
        )
    ]  # fmt: skip
    for condition, tap in groups:
        mine = [r for r in rows if (r["condition"], r["tap"]) == (condition, tap)]
        peaks = sorted(int(r["list_peak"]) for r in mine if r["list_peak"])
        lines.append(
            (
                condition,
                tap,
                str(len(mine)),
                percent(share_of(mine, "keys_right_reviewed", "keys")),
                percent(share_of(mine, "early_right", "early_keys")),
                percent(share_of(mine, "bits_right", "bits")),
                percent(exact_of(mine)),
                str(peaks[len(peaks) // 2]) if peaks else "-",
            )
        )
    return lines


STATED_HEAD: Final = (
    "stated", "messages", "stated on average", "right", "share right", "P[as few]", "P[as many]",
)  # fmt: skip

STATED: Final = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0)
"""Ends of the probabilities that are counted together."""


def _share(right: int, of: int) -> str:
    if not of:
        return "-"
    return wilson(right, of).scaled(100.0).text(".1f", " %")


def _median(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


def median(values: Sequence[float]) -> Interval:
    """The median with its 95 % limits: those values between which it lies by the signs alone."""
    ordered, count = sorted(values), len(values)
    below = 0.0  # P[at most so many of count values are below the median]
    for rank in range(count // 2 + 1):
        below += math.comb(count, rank) / 2**count
        if below > (1 - CONFIDENCE) / 2:
            break
    if rank == 0:  # too few values: none bounds it
        return Interval(_median(values))
    return Interval(_median(values), ordered[rank - 1], ordered[count - rank])


def by_stated(rows: Sequence[Row]) -> Iterator[tuple[float, float, list[tuple[float, int]]]]:
    """Classes of what `text` stated: from, to, and of each message the probability and whether it
    was the one. A tap that hears no ciphertext symbol states nothing.
    """
    stated = [
        (float(r["probability"]), int(r["likeliest_exact"]))
        for r in rows
        if "measurements" not in r.get("condition", "")
    ]
    for low, high in pairwise(STATED):
        mine = [(p, x) for p, x in stated if low <= p < high or (high == 1.0 and p >= low)]
        if mine:
            yield low, high, mine


def tails(stated: Sequence[float], right: int) -> tuple[float, float]:
    """P[as few right] and P[as many], exactly, where each comes true as often as it is stated."""
    among = [1.0]  # probability of each count
    for p in stated:
        among = [a * (1 - p) + b * p for a, b in zip([*among, 0.0], [0.0, *among], strict=True)]
    return sum(among[: right + 1]), sum(among[right:])


@table("reliability", "findings", "secrecy-kinds", "eavesdroppers")
def reliability(kinds: Sequence[Row], others: Sequence[Row]) -> Lines:
    """How often what ``text`` states comes true, by what it states."""
    rows = [*kinds, *others]
    lines: list[tuple[str, ...]] = [STATED_HEAD]
    for low, high, mine in by_stated(rows):
        right = sum(x for _, x in mine)
        few, many = tails([p for p, _ in mine], right)
        lines.append(
            (
                f"{low:g} to {high:g}",
                str(len(mine)),
                f"{sum(p for p, _ in mine) / len(mine):.4f}",
                str(right),
                _share(right, len(mine)),
                f"{few:.3f}",
                f"{many:.3f}",
            )
        )
    return lines
