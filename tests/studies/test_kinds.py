"""The study of kinds of messages, as recorded: what is stated of each comes true."""

import math
from collections.abc import Sequence

import pytest

from protocol.statistics import MISSTATED, wilson
from studies.registry import Row, recorded
from studies.secrecy.kinds import KEPT_BACK, MESSAGES, messages
from studies.secrecy.tables import STATED_HEAD, median, reliability, tails
from tap_service.inference.expectation import expected
from tap_service.inference.message_reader import SURE

TAIL = 0.025
"""Of an exact test, shared by the tests of all kinds on both sides."""


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    return recorded("secrecy-kinds")


def test_there_are_twelve_kinds_of_which_two_were_kept_back() -> None:
    kinds = [message.kind for message in messages()]
    assert len(set(kinds)) == 12
    assert all(kinds.count(kind) == MESSAGES for kind in kinds)
    assert set(KEPT_BACK) <= set(kinds)
    assert not set(KEPT_BACK) & {kind.name for kind in expected().kinds}


def test_what_is_stated_of_each_kind_comes_true_as_often_as_it_is_stated(
    rows: Sequence[Row],
) -> None:
    kinds = {row["kind"] for row in rows}
    assert len(kinds) == 12
    for kind in kinds:
        mine = [row for row in rows if row["kind"] == kind]
        right = sum(int(row["likeliest_exact"]) for row in mine)
        assert min(tails([float(row["probability"]) for row in mine], right)) > TAIL / 12


def test_capitals_are_read_as_often_as_the_same_sentences(rows: Sequence[Row]) -> None:
    """Version 1.0.0 read none of them. The seeds and the losses are the same."""
    right = {(row["kind"], row["seed"]): int(row["likeliest_exact"]) for row in rows}
    seeds = [seed for kind, seed in right if kind == "capitals" and ("sentences", seed) in right]
    capitals, sentences = (
        sum(right[kind, seed] for seed in seeds) for kind in ("capitals", "sentences")
    )
    assert capitals >= sentences - 1 - len(seeds) // 10


@pytest.fixture(scope="module")
def others() -> Sequence[Row]:
    return recorded("eavesdroppers")


def test_a_tap_that_is_sure_is_wrong_no_oftener_than_the_limits_of_its_account_say(
    rows: Sequence[Row], others: Sequence[Row]
) -> None:
    sure = [row for row in (*rows, *others) if float(row["probability"]) >= SURE]
    wrong = sum(not int(row["likeliest_exact"]) for row in sure)
    assert wilson(wrong, len(sure)).high <= MISSTATED


def test_no_class_of_what_is_stated_is_off_by_an_exact_test(
    rows: Sequence[Row], others: Sequence[Row]
) -> None:
    head, *classes = reliability(rows, others)
    assert head == STATED_HEAD
    assert sum(int(messages) for _, messages, *_ in classes) > len(rows)
    for *_, few, many in classes:
        assert min(float(few), float(many)) >= TAIL / len(classes)


def test_a_median_lies_between_the_values_that_the_signs_alone_give() -> None:
    """Of 30 values the 10th and the 21st (a textbook's table); five are too few."""
    found = median([float(i) for i in range(1, 31)])
    assert (found.low, found.high) == (10.0, 21.0)
    assert not median([1.0, 2.0, 3.0, 4.0, 5.0]).known


def test_the_tails_of_a_count_are_exact() -> None:
    """Of a binomial count, and of three messages by hand."""
    alike = [math.comb(10, n) * 0.3**n * 0.7 ** (10 - n) for n in range(11)]
    assert tails([0.3] * 10, 4) == pytest.approx((sum(alike[:5]), sum(alike[4:])))
    assert tails([0.9, 0.5, 0.2], 0) == pytest.approx((0.1 * 0.5 * 0.8, 1.0))
    assert tails([0.9, 0.5, 0.2], 3) == pytest.approx((1.0, 0.9 * 0.5 * 0.2))
