"""The tables of the reading study on docs/findings.md.

``python -m studies.secrecy.reading_tables`` writes them between their marks on the page.
"""

import csv
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from protocol.statistics import CONFIDENCE, Interval, wilson
from studies.pages import markdown_table
from studies.secrecy.reading import FILE
from studies.secrecy.tables import codes_of, put_on_page
from studies.secrecy.tables import read_rows as read_view_rows

Row = dict[str, str]

HEAD: Final = (
    "condition", "tap", "runs", "keys right", "likeliest is it", "share", "claimed and it",
    "bits left", "seconds of a core", "code",
)  # fmt: skip
STATED_HEAD: Final = (
    "stated", "messages", "stated on average", "right", "share right", "P[as few]", "P[as many]",
)  # fmt: skip

STATED: Final = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0)
"""Ends of the probabilities that are counted together."""


def read_rows(path: Path = FILE) -> list[Row]:
    """The study's rows, in the order of their conditions, taps and seeds.

    Raises
    ------
    OSError
        When the file cannot be read.
    """
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def views() -> list[Row]:
    """The rows of the view study, which states how sure she was of its messages too."""
    return read_view_rows("view")


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


def results(rows: Sequence[Row]) -> list[tuple[str, ...]]:
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
                codes_of(mine),
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


def reliability(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """How often what ``text`` states comes true, by what she states."""
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


def misstated(rows: Sequence[Row]) -> str:
    """Of which classes an exact test rejects what was stated."""
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


def write_tables() -> None:
    """Put the tables between their marks on the page."""
    rows = read_rows()
    put_on_page(
        {
            "reading": markdown_table(results(rows)),
            "reliability": markdown_table(reliability([*rows, *views()])),
            "misstated": misstated([*rows, *views()]),
        }
    )


if __name__ == "__main__":
    write_tables()
