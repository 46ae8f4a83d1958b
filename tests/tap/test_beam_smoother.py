"""The Kalman filter under a beam of sequences: against all sequences, and on whole plants."""

import itertools

import numpy as np
import pytest

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from studies.eavesdroppers import LOSS, MEASUREMENTS, OFFERS
from studies.listeners import heard_of
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.inference.beam_smoother import BeamSmoother
from tap_service.inference.fitted_shape import Shape
from tap_service.inference.front import Inference
from tap_service.inference.law import AffineLaw
from tap_service.inference.verdicts import verdicts_of
from tests.support.shipped_run import shipped_run
from tests.support.size import size
from wyner.simulate.engine import transfer

A, B, NOISE = np.array([[0.8]]), np.array([[1.0]]), 0.3


def scalar_steps(count: int, seed: int) -> list[Transition]:
    """One state, two candidates half a unit either side, d even within 0.25; all through noise."""
    rng = np.random.default_rng(seed)
    x, out = np.zeros(count + 1), []
    for k in range(count):
        x[k + 1] = 0.8 * x[k] + 0.5 * rng.choice((-1, 1)) + rng.uniform(-0.25, 0.25)
    y = x + NOISE * rng.standard_normal(count + 1)
    for k in range(count):
        u = np.array([-0.5, 0.5]) + NOISE * rng.standard_normal(2)
        offer = tuple((float(v),) for v in u)
        out.append(Transition("s", k, (y[k],), offer, 0, (y[k + 1],), start=k == 0))
    return out


def by_all_sequences(steps: list[Transition], width: float) -> Array:
    """Probability of the second candidate at each step, d Gaussian, by enumeration."""
    count, wide = len(steps), 12.0
    y = np.array([t.x for t in steps] + [steps[-1].x_next])[:, 0]
    # x as a linear function of x(0) and all d and misread inputs, which are one noise a step
    M = np.zeros((count + 1, count + 1))
    for i in range(count + 1):
        for j in range(i + 1):
            M[i, j] = 0.8 ** (i - j)
    spread = np.diag([(10 * wide) ** 2, *[(width * wide) ** 2 / 3 + NOISE**2] * count])
    S = M @ spread @ M.T + NOISE**2 * np.eye(count + 1)
    inverse, found = np.linalg.inv(S), []
    sequences = np.array(list(itertools.product((0, 1), repeat=count)))
    for choices in sequences:
        u = [0.0] + [steps[k].candidates[c][0] for k, c in enumerate(choices)]  # type: ignore[index]
        off = y - M @ np.array(u)
        found.append(-0.5 * off @ inverse @ off)
    p = np.exp(np.array(found) - max(found))
    return np.asarray(p @ sequences / p.sum())


def test_choices_are_as_likely_as_all_sequences_of_them_say() -> None:
    steps = scalar_steps(8, 3)
    told_set = np.array([[1.0], [-1.0]]) / 12
    smoother = BeamSmoother(A, B, told_set, Shape(told_set), NOISE, None, samples=20_000)
    smoother.learn(steps, steps, 1.0)
    inferred = smoother.infer(steps)
    exact = by_all_sequences(steps, smoother.support)
    told = np.array([s.samples.argmin(axis=1).mean() for s in inferred if s.samples is not None])
    # of two candidates that were misread the nearer may be the other one
    np.testing.assert_allclose(told, exact, atol=0.06)
    ends = [by_all_sequences(steps[i : i + 1], smoother.support)[0] for i in range(len(steps))]
    assert np.abs(ends - exact).max() > 0.1, "a step alone says something else"


def test_an_offer_that_bent_the_law_is_told_by_the_next_state() -> None:
    """By the law the lost state would lie where the other symbol leads, until the next is heard."""
    law = AffineLaw(
        np.full((2, 1, 1), -0.5), np.array([[-0.5], [0.5]]), 1e-6, 0.35, shared=True
    )  # fmt: skip
    v = -0.5 * 0.7 + 0.6
    first, second = ((-0.5,), (0.5,)), ((v - 0.5,), (v + 0.5,))
    steps = [
        Transition("s", 0, (0.0,), first, 0, None, start=True),
        Transition("s", 1, None, second, 0, (0.8 * 0.7 + v + 0.5 + 0.1,)),
    ]
    told_set = np.array([[1.0], [-1.0]]) / 0.3
    smoother = BeamSmoother(A, B, told_set, Shape(told_set), 0.0, law, samples=200)
    said, _ = verdicts_of(smoother.infer(steps), (0.0, 1.0), 2, certain=True)
    assert (said[:, 2] > 0.9).all()


QUICK = [("unicycle", 0, LOSS, False, 0.85, 0.5)]
LONG = [
    ("packed-double-integrator", 1, {"noise": 0.05}, True, 0.94, 0.25),
    ("packed-quadruple-tank", 0, LOSS, True, 0.86, 0.8),
    ("unicycle", 0, OFFERS, True, 0.95, 0.2),
    ("packed-double-integrator", 0, OFFERS, True, 0.95, 0.25),
    ("packed-batch-reactor", 0, OFFERS, True, 0.93, 0.5),
    ("packed-quadruple-tank", 0, OFFERS, True, 0.88, 0.8),
]


@pytest.mark.parametrize(
    ("scenario", "run", "view", "policy", "least", "bits"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.long) for case in LONG[: size(4, 6)])],
)
def test_she_names_most_symbols_and_knows_how_sure_she_is(
    scenario: str, run: int, view: dict[str, object], policy: bool, least: float, bits: float
) -> None:
    runs, _ = shipped_run(scenario, 240, run)
    link = transfer(runs, payloads=[])
    heard_as = View.model_validate({**view, "seed": run})
    heard = heard_of(runs, link, heard_as)
    told = heard_as.knowledge(runs.scenario.knowledge())
    if not policy:
        told = told.model_copy(update={"policy": None})
    inferred = Inference(told).infer(heard)
    said, _ = verdicts_of(inferred.steps, (0.0, 1.0), told.candidates, certain=True)
    coins = np.array([int(runs.coin[s.transition.k, 0]) for s in inferred.steps])
    assert (coins != NO_SYMBOL).all()
    assert (said[:, 1:].argmax(axis=1) == coins).mean() > least
    assert -np.log2(said[np.arange(len(coins)), coins + 1]).mean() < bits


@pytest.mark.long
def test_how_far_the_disturbance_reaches_is_found_by_the_offers() -> None:
    """It reaches 0.83 of D_c, which is an eighth of D_e."""
    runs, _ = shipped_run("packed-double-integrator", 240, 1)
    heard = heard_of(runs, transfer(runs, payloads=[]), View(view="offers"))
    low, _ = Inference(runs.scenario.knowledge()).infer(heard).among
    assert low / 0.95 == pytest.approx(1 / 8 / 1.2, rel=0.2)


@pytest.mark.long
def test_how_wide_the_set_is_is_found_by_the_bends_of_the_law() -> None:
    """Two costs, no state heard: the facets that clip them scale with D_c, an eighth of D_e."""
    runs, _ = shipped_run("sustained", 90, 0)
    heard = heard_of(runs, transfer(runs, payloads=[]), View(view="offers"))
    low, high = Inference(runs.scenario.knowledge()).infer(heard).among
    assert low < 1 / 8 < high < 1.5 * low


def test_of_what_nobody_told_her_she_infers_nothing() -> None:
    runs, _ = shipped_run("packed", 60, 0)
    told = runs.scenario.knowledge().model_copy(update={"policy": None})
    silent = View.model_validate(MEASUREMENTS)
    steps = Inference(told).infer(heard_of(runs, transfer(runs, payloads=[]), silent)).steps
    assert all(s.samples is None for s in steps)
