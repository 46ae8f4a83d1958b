"""What is known up to one relabelling: the best one is found, and its choice is paid for."""

import random
from itertools import permutations
from math import factorial, log

import pytest

from protocol.relabelling import (
    Pairs,
    best_labels,
    in_words,
    known,
    pairs_of,
    right_under,
)
from protocol.statistics import confidence_sequence


def blind(draw: random.Random, size: int, steps: int) -> Pairs:
    return pairs_of((draw.randrange(size), draw.randrange(size)) for _ in range(steps))


def names(labels: tuple[int, ...], steps: int, wrong: int, draw: random.Random) -> Pairs:
    """One whose symbol ``g`` stands for ``labels[g]``, but for some steps."""
    found = []
    for i in range(steps):
        guess = draw.randrange(len(labels))
        found.append((guess, draw.randrange(len(labels)) if i < wrong else labels[guess]))
    return pairs_of(found)


@pytest.mark.parametrize("size", [2, 3, 4, 5])
def test_the_best_labelling_is_the_best_of_all(size: int) -> None:
    draw = random.Random(size)
    for steps in (0, 1, 7, 60):
        pairs = blind(draw, size, steps)
        most = max(right_under(pairs, its) for its in permutations(range(size)))
        assert right_under(pairs, best_labels(pairs, size)) == most


def test_where_no_other_labelling_is_shown_to_be_better_symbols_count_as_named() -> None:
    assert known([pairs_of([(0, 1), (1, 0), (0, 0)])], 2).labels == ()
    straight = names((0, 1, 2, 3), 400, 100, random.Random(1))
    its = known([straight], 4)
    assert (its.labels, its.right) == ((), its.named)
    assert its.share.low == pytest.approx(confidence_sequence(its.named, 400).low, abs=0.003)
    assert known([], 2).of == known([{}], 2).of == 0
    assert not known([], 2).better_than_chance(0.05)


def test_many_runs_of_many_symbols_have_a_finite_price() -> None:
    """(16!)^100 labellings: 1 / their number is no number to a computer."""
    draw = random.Random(100)
    labels = tuple(draw.sample(range(16), 16))
    runs = [names(labels, 100, 5, draw) for _ in range(100)]
    its = known(runs, 16)
    assert its.evidence > 100 * log(factorial(16))
    assert its.labels == (labels,) * 100
    assert its.share.low > 0.5


def test_a_labelling_in_words() -> None:
    assert in_words((1, 0)) == "0 is 1, 1 is 0"
    assert in_words((0, 2, 1)) == "1 is 2, 2 is 1"
