"""Whether a tap's misses fit what was claimed of them.

An audit can refute the claim; it can never prove it, for another tap may be better than this one.
It is looked at again and again while a run goes on, so its verdicts rest on evidence that may be:
however often one looks, an honest run is ever called refuted, or bursty, with the stated
probability at most (:mod:`protocol.statistics`).

What she misses says nothing while she is not there. So copies are left out from the beginning until
she has heard one, and again once she has missed :data:`AWAY` in a row until she hears one. Whether
a copy is left out is decided before it is sent, so those that are left in are as the claim says.
"""

from collections.abc import Mapping, Sequence
from math import exp, inf, lgamma, log
from typing import Final, NamedTuple

from protocol.statistics import better_than, confidence_sequence

ALPHA: Final = 1e-6
"""Chance that an honest run is ever called refuted; the same for bursts. All classes together."""

LAGS: Final = 8
"""Distances at which her misses are looked at for bursts."""

ALL: Final = "messages"
"""The copies of all classes together, where there are several: they refute a claim in half the
steps."""

AWAY: Final = 64
"""Copies of one class that she missed in a row, after which she counts as gone."""


class MissRate(NamedTuple):
    """Her misses over many copies, against the claim.

    ``low`` and ``high`` bound her miss rate at all looks together; ``refuted`` says that even
    ``high`` is below the claim, or was once. ``lag`` is the distance at which misses depend on each
    other most, ``bursts`` whether they do more than chance explains, or did once. ``absent`` copies
    were left out, for she was not there.
    """

    missed: int
    copies: int
    low: float
    high: float
    refuted: bool
    lag: int
    bursts: bool
    absent: int = 0


class Misses:
    """Her misses of one class of copies, in the order in which these were sent; memory is bounded.

    Parameters
    ----------
    claim : float
        Least probability, given everything before, that she misses a copy: eps_E.
    alpha : float
        Chance that either verdict on an honest run is ever wrong.
    """

    def __init__(self, claim: float, alpha: float = ALPHA) -> None:
        self._claim, self._alpha = claim, alpha
        self._copies = self._missed = self.absent = 0
        self._run = 0  # copies missed in a row, up to now
        self._there = False
        self._refuted = self._bursts = False
        self._last = 0  # the last LAGS copies, a bit each, the newest lowest
        self._seen = 0  # of these, since she came
        # by distance: copies by whether they were missed, and whether the one before was
        self._pairs = [[0, 0, 0, 0] for _ in range(LAGS)]

    def add(self, *, missed: bool) -> None:
        """Take the next copy."""
        if not self._there:
            self.absent += 1
            if not missed:
                self._there, self._run, self._last, self._seen = True, 0, 0, 0
            return
        for lag in range(min(self._seen, LAGS)):
            before = self._last >> lag & 1
            self._pairs[lag][2 * (1 - before) + (not missed)] += 1
        self._last = (self._last << 1 | missed) & (1 << LAGS) - 1
        self._seen += 1
        self._copies += 1
        self._missed += missed
        self._run = self._run + 1 if missed else 0
        self._there = self._run < AWAY

    def gone(self) -> None:
        """She is known to have left: nothing counts until she is heard of again."""
        self._there = False

    def judge(self) -> MissRate:
        """Judge all that was taken. What was refuted once stays so."""
        n, k = self._copies, self._missed
        limits = confidence_sequence(k, n, 1 - self._alpha)
        self._refuted |= better_than(1 - self._claim, n - k, n, self._alpha)
        found = [dependence(*pairs) for pairs in self._pairs]
        lag = max(range(LAGS), key=found.__getitem__)
        self._bursts |= _log_mean(found) >= -log(self._alpha)
        low, high = limits.low, limits.high
        return MissRate(k, n, low, high, self._refuted, lag + 1, self._bursts, self.absent)


class Audit:
    """Her misses by class, each judged by itself; both verdicts hold for all classes together.

    Parameters
    ----------
    claim : float
        eps_E, of one appearance: she hears each message over one link of her own.
    classes : sequence of str
        As they are named in what is told.
    """

    def __init__(self, claim: float, classes: Sequence[str]) -> None:
        names = (*classes, ALL) if len(classes) > 1 else tuple(classes)
        self._classes = {name: Misses(claim, ALPHA / len(names)) for name in names}

    def add(self, name: str, *, missed: bool) -> None:
        """Take the next copy of a class."""
        self._classes[name].add(missed=missed)
        if ALL in self._classes:
            self._classes[ALL].add(missed=missed)

    def gone(self) -> None:
        """She is known to have left."""
        for misses in self._classes.values():
            misses.gone()

    def judge(self) -> dict[str, MissRate]:
        """By class."""
        return {name: misses.judge() for name, misses in self._classes.items()}


def worst(rates: Mapping[str, MissRate]) -> tuple[str, MissRate]:
    """The class that speaks against the claim most: one that refutes it, of these the surest."""
    return min(rates.items(), key=lambda item: (not item[1].refuted, item[1].high))


def dependence(miss_miss: int, miss_hit: int, hit_miss: int, hit_hit: int) -> float:
    """Log of the evidence against independent misses of one unknown probability.

    The evidence is the likelihood of what was seen where a copy is missed with one probability
    after a miss and with another after a hit, averaged over both (Krichevsky and Trofimov 1981),
    over the largest that independence can give it. Where misses are independent it is ever above
    1 / alpha with probability alpha at most.

    Parameters
    ----------
    miss_miss, miss_hit, hit_miss, hit_hit : int
        Pairs of copies at one distance: what became of the earlier one, and of the later.
    """
    k, hits = miss_miss + hit_miss, miss_hit + hit_hit
    n = k + hits
    best = (k * log(k / n) if k else 0.0) + (hits * log(hits / n) if hits else 0.0)
    return _averaged(miss_miss, miss_hit) + _averaged(hit_miss, hit_hit) - best


def _averaged(k: int, hits: int) -> float:
    """Log probability of a sequence whose probability is drawn from Beta(1/2, 1/2)."""
    return lgamma(k + 0.5) + lgamma(hits + 0.5) - lgamma(k + hits + 1) - 2 * lgamma(0.5)


def _log_mean(logs: Sequence[float]) -> float:
    largest = max(logs, default=-inf)
    return largest + log(sum(exp(one - largest) for one in logs) / len(logs))
