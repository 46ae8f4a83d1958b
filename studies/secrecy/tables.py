"""The tables of docs/findings.md, from the study's rows.

``python -m studies.secrecy.tables`` writes them between their marks on the page; with
``--measure`` it first adds the rows that their data lack.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from protocol.statistics import Interval
from studies import DATA
from studies.pages import between_marks, markdown_table
from studies.secrecy.study import ALL_READ, measure_study
from tap_service.inference.message_reader import SURE
from wyner.runs.score.report import over_runs, percent
from wyner.runs.score.score import Proportion
from wyner.sweeps.code import ROOT

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


def codes_of(rows: Sequence[Row]) -> str:
    """The states of the code that made rows, each with how many where there are several."""
    found = Counter(row["version"].partition("+")[2] or row["version"] for row in rows)
    if len(found) == 1:
        return next(iter(found))
    return ", ".join(f"{code} ({count})" for code, count in found.most_common())


def table(study: str) -> list[tuple[str, ...]]:
    """One line a condition and eavesdropper."""
    rows = read_rows(study)
    conditions = list(dict.fromkeys(r["condition"] for r in rows))
    found = dict.fromkeys((r["condition"], r["tap"]) for r in rows)
    groups = sorted(found, key=lambda group: conditions.index(group[0]))  # stable by tap
    lines: list[tuple[str, ...]] = [
        (
            "condition", "tap", "runs", "key symbols", "first 200", "bits", "messages", "list",
            "code",
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
                codes_of(mine),
            )
        )
    return lines


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


def write_tables() -> None:
    """Put the tables between their marks on the page."""
    parts = {study: markdown_table(table(study)) for study in TABLES}
    parts["beside"] = against_the_smoother(read_rows("view"))
    put_on_page(parts)


def put_on_page(parts: Mapping[str, str]) -> None:
    """Put each text between its marks on the page."""
    text = PAGE.read_text(encoding="utf-8")
    for name, part in parts.items():
        text = between_marks(text, name, part)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the tables of docs/findings.md.")
    parser.add_argument("--measure", action="store_true", help="add first what their data lack")
    if parser.parse_args().measure:
        for name in TABLES:
            measure_study(name)(DATA / f"secrecy-{name}.csv")
    write_tables()
