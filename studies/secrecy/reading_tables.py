"""The tables of the reading study on docs/findings.md.

``python -m studies.secrecy.reading_tables`` writes them between their marks on the page.
"""

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from protocol.statistics import wilson
from studies.secrecy.reading import FILE
from studies.secrecy.tables import PAGE

Row = dict[str, str]

HEAD: Final = (
    "condition", "tap", "runs", "keys right", "likeliest is it", "share", "claimed and it",
    "bits left", "seconds of a core",
)  # fmt: skip
STATED_HEAD: Final = ("stated", "messages", "stated on average", "right", "share right")

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


def _share(right: int, of: int) -> str:
    if not of:
        return "-"
    return wilson(right, of).scaled(100.0).text(".1f", " %")


def _median(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


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
        bits = f"{_median(left):.1f} of {whole:.0f}" if left else "-"
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


def reliability(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """How often what ``text`` states comes true, by what she states."""
    lines: list[tuple[str, ...]] = [STATED_HEAD]
    # a tap that hears no ciphertext symbol states nothing
    stated = [
        (float(r["probability"]), int(r["likeliest_exact"]))
        for r in rows
        if r["tap"] == "text" and "measurements" not in r["condition"]
    ]
    for low, high in pairwise(STATED):
        mine = [(p, x) for p, x in stated if low <= p < high or (high == 1.0 and p >= low)]
        if not mine:
            continue
        right = sum(x for _, x in mine)
        lines.append(
            (
                f"{low:g} to {high:g}",
                str(len(mine)),
                f"{sum(p for p, _ in mine) / len(mine):.3f}",
                str(right),
                _share(right, len(mine)),
            )
        )
    return lines


def in_markdown(lines: Sequence[tuple[str, ...]]) -> str:
    """Lines as a table; the first is its head."""
    head, *rest = ("| " + " | ".join(line) + " |" for line in lines)
    return "\n".join([head, "|---" * len(lines[0]) + "|", *rest])


def write_tables() -> None:
    """Put the tables between their marks on the page."""
    text, rows = PAGE.read_text(encoding="utf-8"), read_rows()
    for name, lines in (("reading", results(rows)), ("reliability", reliability(rows))):
        begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
        before, _, rest = text.partition(begin)
        _, mark, after = rest.partition(end)
        if mark:
            text = f"{before}{begin}{in_markdown(lines)}\n{end}{after}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_tables()
