"""The tables of docs/findings.md, from the rows of the secrecy studies."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from protocol.statistics import CONFIDENCE, Interval, wilson
from studies.registry import Lines, Row, table
from studies.secrecy.study import ALL_READ
from tap_service.inference.message_reader import SURE
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
@table("view", "findings", "secrecy-view")
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


@table("beside", "findings", "secrecy-view")
def against_the_smoother(rows: Sequence[Row]) -> str:
    """Where `text` stands beside `smoother`, on the runs before both."""
    by = {(r["condition"], r["tap"], r["seed"]): r for r in rows}
    pairs = [
        (r, by[c, "smoother", seed])
        for (c, tap, seed), r in by.items()
        if tap == "text" and (c, "smoother", seed) in by and r["message_bits"]
    ]

    def total(column: str) -> tuple[float, float]:
        hers, its = (sum(float(pair[i][column]) for pair in pairs) for i in (0, 1))
        return hers, its

    exact, bits = total("messages_exact"), total("bits_right")
    below = list(
        dict.fromkeys(
            f"{r['condition']}, seed {r['seed']}"
            for r, s in pairs
            if int(r["messages_exact"]) < int(s["messages_exact"])
        )
    )
    wrong = [
        f"{r['condition']}, seed {r['seed']}: {float(r['probability']):.3f}"
        for r, _ in pairs
        if float(r["probability"]) >= SURE and not int(r["likeliest_exact"])
    ]
    told = (
        f"Of the {len(pairs)} runs before both taps, `text` has the exact message in "
        f"{exact[0]:.0f} and {bits[0]:.0f} bits right, `smoother` in {exact[1]:.0f} and "
        f"{bits[1]:.0f}."
    )
    told += f" Below it: {'; '.join(below)}." if below else " In none `smoother` alone has it."
    told += f" One run each where `smoother` has every message ({', '.join(ALL_READ)})."
    return told + (f" Wrong claims of `text`: {'; '.join(wrong)}." if wrong else "")


HEAD: Final = (
    "condition", "tap", "runs", "keys right", "likeliest is it", "share", "claimed and it",
    "bits left", "seconds of a core",
)  # fmt: skip
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


@table("reading", "findings", "secrecy-reading")
def results(rows: Sequence[Row]) -> Lines:
    """One line a condition and tap."""
    lines: list[tuple[str, ...]] = [HEAD]
    for condition, tap in sorted({(r["condition"], r["tap"]) for r in rows}):
        mine = [r for r in rows if (r["condition"], r["tap"]) == (condition, tap)]
        right = [float(r["keys_right"]) / int(r["keys"]) for r in mine if int(r["keys"])]
        exact = sum(int(r["likeliest_exact"]) > 0 for r in mine)
        claimed = sum(int(r["messages_exact"]) > 0 for r in mine)
        left = [float(r["bits_left"]) for r in mine if r["bits_left"]]
        whole = _median([float(r["message_bits"]) for r in mine])
        bits = f"{median(left).text('.1f')} of {whole:.0f}" if left else "-"
        cost = _median([float(r["cpu_s"]) for r in mine])
        lines.append(
            (
                condition,
                tap,
                str(len(mine)),
                f"{100 * sum(right) / len(right):.1f} %" if right else "-",
                f"{exact} of {len(mine)}",
                _share(exact, len(mine)),
                str(claimed),
                bits,
                f"{cost:.0f}",
            )
        )
    return lines


def by_stated(rows: Sequence[Row]) -> Iterator[tuple[float, float, list[tuple[float, int]]]]:
    """Classes of what `text` stated: from, to, and of each message the probability and whether it
    was the one. A tap that hears no ciphertext symbol states nothing.
    """
    stated = [
        (float(r["probability"]), int(r["likeliest_exact"]))
        for r in rows
        if r["tap"] == "text" and r["probability"] and "measurements" not in r["condition"]
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


@table("reliability", "findings", "secrecy-reading", "secrecy-view")
def reliability(readings: Sequence[Row], views: Sequence[Row]) -> Lines:
    """How often what ``text`` states comes true, by what she states."""
    rows = [*readings, *views]
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


@table("misstated", "findings", "secrecy-reading", "secrecy-view")
def misstated(readings: Sequence[Row], views: Sequence[Row]) -> str:
    """Of which classes an exact test rejects what was stated."""
    rows = [*readings, *views]
    outside, least = [], 1.0
    for low, high, mine in by_stated(rows):
        right = sum(x for _, x in mine)
        few, many = tails([p for p, _ in mine], right)
        least = min(least, few, many)
        if min(few, many) < (1 - CONFIDENCE) / 2:
            what = "more" if few < many else "less"
            outside.append(
                f"{low:g} to {high:g}, where {what} is stated than {right} of {len(mine)} bears out"
            )
    if not outside:
        return (
            f"No class is off by an exact test: no tail is below 2.5 %, the least is {least:.3f}."
        )
    return f"Off by an exact test, at 2.5 % a tail: {'; '.join(outside)}."
