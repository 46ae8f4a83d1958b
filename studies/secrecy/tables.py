"""The tables of docs/findings.md, from the study's rows.

``python -m studies.secrecy.tables`` writes them between their marks on the page; with
``--measure`` it first adds the rows that their data lack.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from protocol.statistics import Interval
from studies import DATA
from studies.secrecy.study import measure_study
from wyner.runs.score.report import over_runs, percent
from wyner.runs.score.score import Proportion
from wyner.sweeps.grid import ROOT

PAGE: Final = ROOT / "docs" / "findings.md"

TABLES: Final = ("ladder", "learning", "view")
"""Studies whose table the page shows; that of alpha is a figure."""

Row = dict[str, str]


def read_rows(study: str, data: Path = DATA) -> list[Row]:
    """The rows of a study.

    Raises
    ------
    OSError
        When its file cannot be read.
    """
    with (data / f"secrecy-{study}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def share_of(rows: Sequence[Row], right: str, of: str) -> Interval:
    """A share over runs with its interval."""
    return over_runs([Proportion(float(r[right]), int(r[of])) for r in rows])


def exact_of(rows: Sequence[Row]) -> Interval:
    """Share of runs whose message was had whole and exact, of those in which the plant had it."""
    return share_of(rows, "messages_exact", "messages")


def table(study: str) -> list[tuple[str, ...]]:
    """One line a condition and eavesdropper."""
    rows = read_rows(study)
    groups = dict.fromkeys((r["condition"], r["tap"]) for r in rows)
    lines: list[tuple[str, ...]] = [
        ("condition", "tap", "runs", "key symbols", "first 200", "bits", "messages", "list")
    ]
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


def in_markdown(study: str) -> str:
    """The table of a study as the page holds it."""
    head, *lines = ("| " + " | ".join(line) + " |" for line in table(study))
    return "\n".join([head, "|---" * head.count(" | ") + "|---|", *lines])


def write_tables() -> None:
    """Put the tables between their marks on the page."""
    text = PAGE.read_text(encoding="utf-8")
    for study in TABLES:
        begin, end = f"<!-- begin {study} -->\n", f"<!-- end {study} -->"
        before, _, rest = text.partition(begin)
        _, mark, after = rest.partition(end)
        if mark:
            text = f"{before}{begin}{in_markdown(study)}\n{end}{after}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the tables of docs/findings.md.")
    parser.add_argument("--measure", action="store_true", help="add first what their data lack")
    if parser.parse_args().measure:
        for name in TABLES:
            measure_study(name)(DATA / f"secrecy-{name}.csv")
    write_tables()
