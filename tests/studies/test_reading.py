"""The reading study's recorded runs: what the page shows of them, and that what is stated holds."""

import math
from collections.abc import Sequence

import pytest

from protocol.statistics import MISSTATED, wilson
from studies.registry import Row, recorded
from studies.secrecy.reading import ANY_BYTES
from studies.secrecy.tables import STATED_HEAD, median, misstated, reliability, tails
from tap_service.inference.message_reader import SURE


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    return recorded("secrecy-reading")


def views() -> Sequence[Row]:
    return recorded("secrecy-view")


def test_a_median_lies_between_the_values_that_the_signs_alone_give() -> None:
    """Of 30 values the 10th and the 21st (a textbook's table); five are too few."""
    found = median([float(i) for i in range(1, 31)])
    assert (found.low, found.high) == (10.0, 21.0)
    assert not median([1.0, 2.0, 3.0, 4.0, 5.0]).known


def test_a_tap_that_is_sure_is_wrong_no_oftener_than_the_limits_of_her_account_say(
    rows: Sequence[Row],
) -> None:
    """Wrong claims count as the right ones do."""
    stated = [r for r in (*rows, *views()) if r["tap"] == "text" and r["probability"]]
    sure = [r for r in stated if float(r["probability"]) >= SURE]
    wrong = sum(not int(r["likeliest_exact"]) for r in sure)
    assert wrong, "one claim at .996 is known to be wrong: it counts"
    assert wilson(wrong, len(sure)).high <= MISSTATED


def test_what_text_states_comes_true_as_often_as_it_is_stated(rows: Sequence[Row]) -> None:
    """Over 200 messages under mixed views: below .99 each class's mean lies within the interval
    measured, and of no class an exact test rejects it. Above it one claim was wrong.
    """
    everything = [*rows, *views()]
    head, *classes = reliability(everything, [])
    assert head == STATED_HEAD
    counted = 0
    for name, messages, stated, right, _, few, many in classes:
        limits = wilson(int(right), int(messages))
        assert min(float(few), float(many)) >= 0.025
        if name != "0.99 to 1":
            assert limits.low <= float(stated) <= limits.high
        counted += int(messages)
    assert counted >= 200
    (top,) = [c for c in classes if c[0] == "0.99 to 1"]
    assert int(top[3]) >= 0.98 * int(top[1])


def test_the_tails_of_a_count_are_exact() -> None:
    """Of a binomial count, and of three messages by hand."""
    alike = [math.comb(10, n) * 0.3**n * 0.7 ** (10 - n) for n in range(11)]
    assert tails([0.3] * 10, 4) == pytest.approx((sum(alike[:5]), sum(alike[4:])))
    assert tails([0.9, 0.5, 0.2], 0) == pytest.approx((0.1 * 0.5 * 0.8, 1.0))
    assert tails([0.9, 0.5, 0.2], 3) == pytest.approx((1.0, 0.9 * 0.5 * 0.2))


def test_a_tap_that_states_too_much_or_too_little_is_called_so() -> None:
    def rows_of(stated: float, right: int) -> list[Row]:
        return [
            {"tap": "text", "condition": "", "probability": str(stated), "likeliest_exact": str(x)}
            for x in [1] * right + [0] * (100 - right)
        ]

    assert "no tail is below" in misstated(rows_of(0.8, 80), [])
    assert "0.5 to 0.9, where more is stated than 60 of 100" in misstated(rows_of(0.8, 60), [])
    assert "0.5 to 0.9, where less is stated than 95 of 100" in misstated(rows_of(0.8, 95), [])


def test_random_bytes_leave_no_more_to_one_who_expected_english(rows: Sequence[Row]) -> None:
    def left(tap: str) -> dict[str, float]:
        condition = "packed, random bytes, loss 30 %"
        mine = (r for r in rows if (r["tap"], r["condition"]) == (tap, condition))
        return {r["seed"]: float(r["bits_left"]) for r in mine}

    english, none = left("text"), left(ANY_BYTES)
    assert len(english) == 10
    assert english.keys() == none.keys()
    for seed, bits in english.items():
        assert none[seed] - 1.0 < bits < none[seed] + 1.0
