"""The study of kinds of messages, as recorded: what is stated of each comes true."""

import math

import pytest

from studies.registry import recorded
from studies.secrecy.tables import STATED_HEAD, median, reliability, tails

TAIL = 0.025
"""Of an exact test, shared by the tests of all kinds on both sides."""


def test_no_class_of_what_is_stated_is_off_by_an_exact_test() -> None:
    rows, others = recorded("secrecy-kinds"), recorded("eavesdroppers")
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
