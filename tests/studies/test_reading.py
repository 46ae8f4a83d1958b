"""The reading study's recorded runs: what the page shows of them, and that what is stated holds."""

from collections.abc import Sequence

import pytest

from protocol.statistics import wilson
from studies.secrecy.reading import ANY_BYTES
from studies.secrecy.reading_tables import (
    STATED_HEAD,
    Row,
    in_markdown,
    read_rows,
    reliability,
    results,
)
from studies.secrecy.tables import PAGE


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    return read_rows()


def test_the_page_shows_the_tables_of_its_data(rows: Sequence[Row]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert in_markdown(results(rows)) in text
    assert in_markdown(reliability(rows)) in text


def test_what_text_states_comes_true_as_often_as_it_is_stated(rows: Sequence[Row]) -> None:
    """Over 200 messages under mixed views: each class's mean lies within the interval measured."""
    head, *classes = reliability(rows)
    assert head == STATED_HEAD
    counted = 0
    for _, messages, stated, right, _ in classes:
        limits = wilson(int(right), int(messages))
        assert limits.low - 5e-4 <= float(stated) <= limits.high + 5e-4
        counted += int(messages)
    assert counted >= 200


@pytest.mark.parametrize(
    ("condition", "runs", "least"),
    [
        ("packed, loss 30 %", 30, 28),
        ("packed, offers only", 30, 26),
        ("packed, noise 0.05", 30, 28),
        ("packed, loss 50 %", 30, 5),
        ("sustained, loss 10 %", 20, 14),
        ("sustained, loss 30 %", 20, 8),
    ],
)
def test_text_reads_what_a_stranger_read(
    rows: Sequence[Row], condition: str, runs: int, least: int
) -> None:
    """By her likeliest message: of the same views an independent decoder had so many."""
    mine = [r for r in rows if (r["condition"], r["tap"]) == (condition, "text")]
    assert len({r["seed"] for r in mine}) == len(mine) == runs
    assert sum(int(r["likeliest_exact"]) for r in mine) >= least


def test_measurements_alone_give_the_keys_and_no_message(rows: Sequence[Row]) -> None:
    mine = [r for r in rows if (r["condition"], r["tap"]) == ("packed, measurements only", "text")]
    right = sum(float(r["keys_right"]) for r in mine)
    assert len(mine) == 30
    assert right >= 0.95 * sum(int(r["keys"]) for r in mine)
    assert not any(int(r["messages_exact"]) for r in mine)


def test_random_bytes_leave_no_more_to_one_who_expected_english(rows: Sequence[Row]) -> None:
    def left(tap: str) -> dict[str, float]:
        mine = (r for r in rows if r["tap"] == tap and "random bytes" in r["condition"])
        return {r["seed"]: float(r["bits_left"]) for r in mine}

    english, none = left("text"), left(ANY_BYTES)
    assert len(english) == 10
    assert english.keys() == none.keys()
    for seed, bits in english.items():
        assert none[seed] - 1.0 < bits < none[seed] + 1.0
