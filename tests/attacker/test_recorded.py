"""The table of live attacked runs: what is measured anew takes the place of its own rows alone."""

import csv
from typing import Any

from tests.attacker.live_runs import DATA, merged


def recorded() -> list[dict[str, str]]:
    with DATA.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def rows(coin: str, size: int, runs: int) -> list[dict[str, Any]]:
    return [
        {"scenario": "packed", "coin": coin, "candidates": size, "steps": n, "runs": runs}
        for n in range(1, 7)
    ]


def test_rows_that_were_not_measured_anew_stay() -> None:
    assert merged(recorded(), []) == recorded()
    found = merged(recorded(), rows("keyed", 4, 1000))
    private = [row for row in recorded() if row["coin"] == "private"]
    assert [row for row in found if row["coin"] == "private"] == private
    assert {row["runs"] for row in found if row["coin"] == "keyed"} == {"200", "199", 1000}
    assert len(found) == len(recorded())


def test_fewer_runs_than_are_on_record_replace_nothing() -> None:
    assert merged(recorded(), rows("private", 2, 3)) == recorded()
