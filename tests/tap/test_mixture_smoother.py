"""Steps read through noise: against all sequences of choices, and against each step alone."""

import itertools

import numpy as np
import pytest

from protocol.arrays import Array
from studies.secrecy.runs import Run, simulate
from studies.secrecy.study import heard_by, output_about
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import smoother
from tap_service.inference.fitted_shape import Shape
from tap_service.inference.front import Inference
from tap_service.inference.gap_smoother import GapSmoother
from tap_service.inference.inferred import InferredStep
from tap_service.inference.mixture_smoother import SIZES, MixtureSmoother
from tap_service.inference.verdicts import verdicts_of
from tests.support.size import size
from wyner.runs.score.score import score

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


def by_all_sequences(steps: list[Transition], size: float) -> Array:
    """Probability of the second candidate at each step, d Gaussian, by enumeration."""
    count, wide = len(steps), 12.0
    y = np.array([t.x for t in steps] + [steps[-1].x_next])[:, 0]
    # x as a linear function of x(0) and all d and misread inputs, which are one noise a step
    M = np.zeros((count + 1, count + 1))
    for i in range(count + 1):
        for j in range(i + 1):
            M[i, j] = 0.8 ** (i - j)
    spread = np.diag([(10 * wide) ** 2, *[(size * wide) ** 2 / 3 + NOISE**2] * count])
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
    smoother = MixtureSmoother(A, B, np.array([[1.0], [-1.0]]) / 12, NOISE, None, samples=20_000)
    inferred = smoother.infer(steps)
    assert smoother.support in SIZES
    exact = by_all_sequences(steps, smoother.support)
    told = np.array([s.samples.argmin(axis=1).mean() for s in inferred if s.samples is not None])
    # of two candidates that were misread the nearer may be the other one
    np.testing.assert_allclose(told, exact, atol=0.04)
    ends = [by_all_sequences(steps[i : i + 1], smoother.support)[0] for i in range(len(steps))]
    assert np.abs(ends - exact).max() > 0.1, "a step alone says something else"


def lost(run: Run, steps: list[InferredStep], among: tuple[float, float]) -> float:
    """Bits that she lacks of each key, by what she states."""
    size = run.scenario.secrecy.candidates
    said, _ = verdicts_of(steps, among, size, certain=True)
    keys = [run.truth.keys[s.transition.session, s.transition.k] for s in steps]
    return float(-np.log2(said[np.arange(len(keys)), np.array(keys) + 1]).mean())


@pytest.mark.long
@pytest.mark.parametrize(
    ("plant", "noise", "missed"),
    [
        *size([], [("packed-quadruple-tank", 0.05, 0.0)]),
        ("packed-quadruple-tank", 0.02, 0.2),
        ("packed-batch-reactor", 0.05, 0.0),
    ],
)
def test_what_went_before_and_came_after_says_more_than_each_step_alone(
    plant: str, noise: float, missed: float
) -> None:
    run = simulate(124, 11, name=plant, payloads=[b"Go on now."])
    view = View(seed=11, noise=noise, loss=missed)
    heard, told = heard_by(run, view), view.knowledge(run.scenario.knowledge())
    together = Inference(told).infer(heard)
    shape = np.array(told.disturbance_H) / np.array(told.disturbance_h)[:, None]
    alone = GapSmoother(np.array(told.A), np.array(told.B), Shape(shape), noise, samples=96)
    bits = [lost(run, s, (0.0, 1.0)) for s in (together.steps, alone.infer(heard))]
    assert bits[0] < bits[1] - 0.5


@pytest.mark.long
def test_on_a_plant_of_four_states_she_is_not_below_the_smoother(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both are asked at the end alone."""
    monkeypatch.setattr(smoother, "FIRST", 300)
    right = np.zeros(2)
    for seed in size((22, 23), (21, 22, 23)):
        run = simulate(300, seed, name="quadruple-tank", payloads=[b"Go."])
        view = View(seed=seed, noise=0.05)
        heard, told = heard_by(run, view), view.knowledge(run.scenario.knowledge())
        inferred = Inference(told).infer(heard)
        said, _ = verdicts_of(inferred.steps, inferred.among, 2, certain=False)
        likelier = said[:, 1:].argmax(axis=1).tolist()
        keys = [run.truth.keys.get((t.session, t.k), -1) for t in heard]
        other = output_about(smoother.Smoother(told), heard)
        right[0] += sum(a == b for a, b in zip(likelier, keys, strict=True))
        right[1] += float(score(run.truth, other).keys_reviewed.right)
    assert right[0] >= right[1]
