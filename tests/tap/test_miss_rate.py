"""The audit of her misses: each direction by itself, only while she was there, and looked at often.

The level of what is looked at after every copy is tested on simulated honest runs.
"""

import random
from collections.abc import Iterable

import numpy as np
import pytest

from plant_service.punctuality import DOUBT, ReachWatch
from protocol.agreement import AgreementResult
from protocol.scenario import Calibration
from protocol.statistics import better_than
from tap_service.inference.miss_rate import ALPHA, AWAY, Audit, Misses, MissRate, worst
from tests.support.size import size

RUNS = 10_000
LEVEL = 0.01
"""Stated for the simulations: at 1e-6 nothing would be seen in so many runs."""


def miss_rate(missed: Iterable[bool], claim: float) -> MissRate:
    misses = Misses(claim)
    for one in missed:
        misses.add(missed=one)
    return misses.judge()


def crossed(boundary: np.ndarray, probability: float, seed: int) -> float:
    """Share of RUNS in which the successes ever reach the boundary, looked at after each trial."""
    draw = np.random.default_rng(seed)
    found = 0
    for _ in range(RUNS // 500):
        successes = np.cumsum(draw.random((500, len(boundary))) < probability, axis=1)
        found += int((successes >= boundary).any(axis=1).sum())
    return found / RUNS


def boundary_of(chance: float, trials: int, alpha: float) -> np.ndarray:
    """The fewest successes that say she succeeds more often than by chance, after each trial."""
    fewest, boundary = 0, []
    for n in range(1, trials + 1):
        while fewest <= n and not better_than(chance, fewest, n, alpha):
            fewest += 1
        boundary.append(fewest)
    return np.array(boundary)


@pytest.mark.long
@pytest.mark.parametrize("claim", size([0.3], [0.05, 0.3, 0.5]))
def test_an_honest_run_is_refuted_no_more_often_than_stated_though_looked_at_always(
    claim: float,
) -> None:
    """2000 looks a run, 10,000 runs; a bound made for one look is wrong in 7 to 12 %."""
    from scipy.special import betaincinv

    share = crossed(boundary_of(1 - claim, 2000, LEVEL), 1 - claim, seed=1)
    assert 0 < share <= LEVEL
    missed = np.arange(2001)
    fewest = []
    for n in range(1, 2001):  # Clopper and Pearson's upper bound, below the claim
        k = missed[:n]
        refuted = int((betaincinv(k + 1, n - k, 1 - LEVEL) < claim).sum())
        fewest.append(n - refuted + 1)
    assert crossed(np.array(fewest), 1 - claim, seed=1) > 4 * LEVEL


@pytest.mark.long
def test_independent_misses_are_called_bursts_no_more_often_than_stated() -> None:
    """12 looks a run at all distances together, 500 or 1,500 runs."""
    draw, runs = random.Random(5), size(500, 1500)
    flagged = 0
    for _ in range(runs):
        misses = Misses(0.3, LEVEL)
        misses.add(missed=False)
        for i in range(1, 145):
            misses.add(missed=draw.random() < 0.3)
            if i % 12 == 0:
                found = misses.judge().bursts
        flagged += found  # what was found once stays
    assert flagged <= LEVEL * runs


@pytest.mark.slow
@pytest.mark.parametrize("violation", [0.05, 0.2])
def test_a_kept_promise_of_d_c_is_doubted_no_more_often_than_stated(violation: float) -> None:
    """After every session, 2000 of them: 10,000 plants."""
    share = crossed(boundary_of(violation, 2000, DOUBT), violation, seed=2)
    assert share <= DOUBT + 3 * (DOUBT / RUNS) ** 0.5


@pytest.mark.parametrize("violation", [0.05, 0.2])
def test_the_watch_of_d_c_doubts_at_that_boundary_and_no_session_sooner(violation: float) -> None:
    """Sessions of two steps that leave D_c as soon as that does not reach the boundary yet."""
    promise = Calibration(
        sessions=100, steps=2, exceeded=0, violation=violation, confidence=0.99, law_fingerprint="x"
    )
    boundary = boundary_of(violation, 300, DOUBT).tolist()
    watch = ReachWatch(promise)
    inside, outside = AgreementResult((0.5, 2.0), -1), AgreementResult((1.5, 2.0), -1)
    for fewest in boundary[:-1]:
        leaves = watch.exceeded + 1 < fewest
        told = [watch.counted(outside if leaves else inside, 0), watch.counted(inside, 0)]
        assert not any(told)
        assert not watch.doubt
    while watch.exceeded < boundary[watch.sessions - 1]:
        assert not watch.doubt
        told = [watch.counted(outside, 0), watch.counted(inside, 0)]
        boundary += boundary_of(violation, watch.sessions + 1, DOUBT)[len(boundary) :].tolist()
    assert watch.doubt
    assert watch.outside == watch.exceeded
    assert told[0] is None
    assert "of them; fit it anew" in (told[1] or "")
    assert not any(watch.counted(outside, 0) for _ in range(9)), "it is told once"


def test_true_faults_are_found() -> None:
    draw = random.Random(3)
    assert miss_rate([draw.random() < 0.25 for _ in range(8000)], 0.3).refuted
    bad, bursts = False, []
    for _ in range(2000):
        bad = draw.random() >= 0.2 if bad else draw.random() < 0.086
        bursts.append(bad)
    found = miss_rate(bursts, 0.1)
    assert found.bursts
    assert found.lag == 1


def test_a_tap_that_misses_in_one_direction_only_is_refuted_in_the_other() -> None:
    """Pooled, she misses 45 % where 30 % were claimed, and nothing was said."""
    draw = random.Random(7)
    audit = Audit(0.3, ("offers", "measurements"))
    pooled = []
    for _ in range(1000):
        offer = draw.random() < 0.9
        audit.add("offers", missed=offer)
        audit.add("measurements", missed=False)
        pooled += [offer, False]
    assert not miss_rate(pooled, 0.3).refuted
    rates = audit.judge()
    assert (rates["offers"].refuted, rates["measurements"].refuted) == (False, True)
    name, rate = worst(rates)
    assert name == "measurements"
    assert rate.high < 0.03


def test_what_was_sent_before_she_came_is_no_miss() -> None:
    late = [True] * 1000 + [False] * 500
    rate = miss_rate(late, 0.3)
    assert (rate.absent, rate.copies, rate.missed) == (1001, 499, 0)
    assert rate.refuted
    assert not rate.bursts


def test_while_she_is_away_nothing_counts_but_the_first_copies() -> None:
    misses = Misses(0.3)
    for missed in [False] * 200 + [True] * 5000 + [False] * 200:
        misses.add(missed=missed)
    rate = misses.judge()
    assert rate.missed == AWAY
    assert rate.absent == 1 + 5000 - AWAY + 1
    assert rate.refuted
    known = Misses(0.3)
    for missed in [False] * 200:
        known.add(missed=missed)
    known.gone()
    for missed in [True] * 5000 + [False] * 200:
        known.add(missed=missed)
    rate = known.judge()
    assert (rate.missed, rate.bursts) == (0, False)


def test_who_never_came_says_nothing() -> None:
    rate = miss_rate([True] * 3000, 0.3)
    assert (rate.copies, rate.absent, rate.refuted, rate.bursts) == (0, 3000, False, False)
    assert (rate.low, rate.high) == (0.0, 1.0)


def test_leaving_out_her_absences_makes_no_honest_run_dishonest() -> None:
    """A channel that goes on missing once it has begun: at each copy it misses three of ten."""
    draw = random.Random(11)
    for _ in range(200):
        misses = Misses(0.3)
        run = 0
        for _ in range(3000):
            missed = draw.random() < (0.3 if not run or run > 2 * AWAY else 1.0)
            run = run + 1 if missed else 0
            misses.add(missed=missed)
        assert not misses.judge().refuted


def test_what_was_refuted_once_stays_so() -> None:
    misses = Misses(0.3)
    for _ in range(300):
        misses.add(missed=False)
    assert misses.judge().refuted
    draw = random.Random(1)
    for _ in range(3000):
        misses.add(missed=draw.random() < 0.9)
    assert misses.judge().refuted
    assert ALPHA < LEVEL
