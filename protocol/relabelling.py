"""What Eve knows of symbols, whatever they are called: right up to one fixed relabelling.

A tap whose model is mirrored names every symbol wrong, and knows every one: to read 0 for Eve's 1
is enough. So what counts is the share of steps at which Eve is right under the one permutation of
the M symbols, the same for all steps of a run, that suits Eve best.

Choosing the best of M! permutations makes a blind guess look better than it is, and the figures
here pay for the choice. Nine tenths of the level are for the symbols as Eve names them, the rest is
shared equally among all other labellings, M! - 1 of one run; of R runs, each with a labelling of
its own, (M!)^R - 1. Each labelling by itself has the evidence and the limits of
:mod:`protocol.statistics`, which hold at every look; by the union bound they hold for all
labellings together, so also for the one that was chosen after looking. It costs 0.1 nats of
evidence as named, and ln 10 + ln(M! - 1) otherwise: 33 nats for M = 16, where each symbol that Eve
knows brings up to 2.8.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import permutations
from math import factorial, inf, log
from typing import Final, NamedTuple

from protocol.statistics import CONFIDENCE, Interval, log_evidence, sequence_limits

Pairs = Mapping[tuple[int, int], int]
"""Steps by what Eve named and what was true: a confusion matrix."""

Labels = tuple[int, ...]
"""The true symbol that each of Eve's stands for."""

ENUMERATED: Final = 4
"""M up to which all permutations are tried; beyond it the best one is an assignment problem."""


AS_NAMED: Final = 0.9
"""Share of the level that is for the symbols as Eve names them."""


class KnownSymbols(NamedTuple):
    """What Eve knows of symbols, over one run or more.

    Parameters
    ----------
    of : int
        Steps.
    named : int
        Those at which Eve named the true symbol.
    right : int
        Those at which Eve is right under the labellings that count: as named, unless others are
        shown to suit Eve better.
    share : Interval
        P_g, that share, with limits that pay for the choice.
    labels : tuple of tuple of int
        By run; empty where the symbols count as named.
    evidence : float
        Natural logarithm of the evidence that Eve does better than chance, the choice paid for.
    """

    of: int
    named: int
    right: int
    share: Interval
    labels: tuple[Labels, ...]
    evidence: float

    def better_than_chance(self, alpha: float) -> bool:
        """Whether that is shown; of a blind one with probability ``alpha`` at most."""
        return self.evidence >= -log(alpha)


def pairs_of(guesses: Iterable[tuple[int, int]]) -> Counter[tuple[int, int]]:
    """Steps by what Eve named and what was true."""
    return Counter(guesses)


def best_labels(pairs: Pairs, size: int) -> Labels:
    """The labelling under which most steps are right; as named where no other is better."""
    as_named = tuple(range(size))
    if size <= ENUMERATED:
        return max(permutations(as_named), key=lambda labels: right_under(pairs, labels))
    import numpy as np
    from scipy.optimize import linear_sum_assignment

    steps = np.zeros((size, size))
    for (guess, key), times in pairs.items():
        if guess in as_named and key in as_named:
            steps[guess, key] = times
    labels = tuple(linear_sum_assignment(steps, maximize=True)[1].tolist())
    return labels if right_under(pairs, labels) > right_under(pairs, as_named) else as_named


def right_under(pairs: Pairs, labels: Labels) -> int:
    """Steps at which Eve is right where Eve's symbols stand for these."""
    return sum(pairs.get((guess, key), 0) for guess, key in enumerate(labels))


def known(runs: Sequence[Pairs], size: int, confidence: float = CONFIDENCE) -> KnownSymbols:
    """What Eve knows of the symbols of some runs, each with one labelling for all its steps.

    Parameters
    ----------
    runs : sequence of mapping
        Of each run steps by what Eve named and what was true.
    size : int
        M.
    confidence : float
        Probability that the limits hold at all looks.
    """
    of = sum(sum(pairs.values()) for pairs in runs)
    as_named = tuple(range(size))
    named = sum(right_under(pairs, as_named) for pairs in runs)
    heard = [pairs for pairs in runs if pairs]
    labels = tuple(best_labels(pairs, size) for pairs in runs)
    best = sum(right_under(pairs, its) for pairs, its in zip(runs, labels, strict=True))
    mine = -log(AS_NAMED)
    others = -log(1 - AS_NAMED) + log(max(1, factorial(size) ** len(heard) - 1))
    evidence = max(_above(named, of, size) - mine, _above(best, of, size) - others)
    level = -log(1 - confidence)
    as_she_names = sequence_limits(named, of, level + mine)
    if best == named:
        return KnownSymbols(of, named, named, as_she_names, (), evidence)
    relabelled = sequence_limits(best, of, level + others)
    low, high = (max(ends) for ends in zip(as_she_names[1:], relabelled[1:], strict=True))
    if relabelled.low <= max(as_she_names.low, 1 / size):  # no other is shown to be better
        return KnownSymbols(of, named, named, Interval(as_she_names.value, low, high), (), evidence)
    return KnownSymbols(of, named, best, Interval(relabelled.value, low, high), labels, evidence)


def _above(right: int, of: int, size: int) -> float:
    """Evidence that a share is not chance, where it is above."""
    return log_evidence(right, of, 1 / size) if right * size > of else -inf


def in_words(labels: Labels) -> str:
    """A labelling as ``0 is 1, 1 is 0``, without the symbols that keep their name."""
    moved = [f"{hers} is {true}" for hers, true in enumerate(labels) if hers != true]
    return ", ".join(moved)
