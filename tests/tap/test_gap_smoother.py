"""Lost states and offers: the law's pieces, and what they and the dynamics give back."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.messages import Measurement, Offer
from studies.secrecy.runs import Run, simulate
from studies.secrecy.study import heard_by
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transcript, Transition
from tap_service.inference.fitted_shape import Shape
from tap_service.inference.gap_smoother import GapSmoother
from tap_service.inference.inferred import InferredStep
from tap_service.inference.law_pieces import UNKNOWN, LawNearby, LawPieces, learn_law

RNG = np.random.default_rng(0)


def law(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two inputs of two components each, affine in pieces over the plane; shape (N, 2, 2)."""
    first = np.clip(-2 * x[:, 0] - x[:, 1], -1, 1)
    second = np.maximum(0.5 * x[:, 0] - 0.2, 0.0)
    third = x[:, 1] + 3
    fourth = np.where(x[:, 0] > 0, x[:, 0], -2 * x[:, 0])
    out: NDArray[np.float64] = np.column_stack([first, second, third, fourth])
    return np.array([column.reshape(2, 2) for column in out])


RUN = (800, 21)
"""Steps and seed."""


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(*RUN)


def shape_of(run: Run) -> NDArray[np.float64]:
    k = run.scenario.knowledge()
    shape: NDArray[np.float64] = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
    return shape


def infer(run: Run, transitions: list[Transition], noise: float = 0.0) -> list[InferredStep]:
    A, B = np.array(run.scenario.A), np.array(run.scenario.B)
    return GapSmoother(A, B, Shape(shape_of(run)), noise).infer(transitions)


def without(run: Run, *lost: tuple[type, int]) -> list[Transition]:
    transcript = Transcript()
    kept = [m for m in run.messages if (type(m), m.k) not in lost]
    return [t for m in kept for t in transcript.hear(m)] + transcript.flush()


@cache
def heard_whole() -> dict[int, Transition]:
    return {t.k: t for t in heard_by(simulate(*RUN), View())}


def true_gauges(run: Run, k: int) -> np.ndarray:
    t = heard_whole()[k]
    assert t.x_next is not None
    A, B = np.array(run.scenario.A), np.array(run.scenario.B)
    residual = np.array(t.x_next) - A @ np.array(t.x) - np.array(t.candidates) @ B.T
    return np.asarray((residual @ shape_of(run).T).max(axis=1))


def test_pieces_are_found_and_cover_the_law() -> None:
    x = RNG.uniform(-1, 1, (600, 2))
    pieces = LawPieces(x, law(x))
    assert pieces.explained > 0.98


def test_a_reading_on_the_right_pieces_holds_the_state() -> None:
    x, unseen = RNG.uniform(-1, 1, (600, 2)), RNG.uniform(-1, 1, (50, 2))
    pieces = LawPieces(x, law(x))
    found = 0
    for state, offer in zip(unseen, law(unseen), strict=True):
        found += any(
            len(r.y) and np.abs(r.C @ state - r.y).max() < 1e-6 for r in pieces.readings(offer)
        )
    assert found >= 48


def test_a_form_around_the_state_gives_the_offer() -> None:
    x, unseen = RNG.uniform(-1, 1, (600, 2)), RNG.uniform(-1, 1, (50, 2))
    pieces = LawPieces(x, law(x))
    found = 0
    for state, offer in zip(unseen, law(unseen), strict=True):
        forms = pieces.forms(state)
        found += any(np.abs(f.at(state[None])[0] - offer).max() < 1e-6 for f in forms)
        assert sum(np.exp(f.weight) for f in forms) <= 1 + 1e-9
    assert found >= 47


def test_a_law_without_pieces_is_averaged_nearby() -> None:
    x = RNG.uniform(-1, 1, (600, 2))
    u = np.stack([np.sin(3 * x[:, 0]), np.cos(2 * x[:, 1])], axis=1).reshape(-1, 2, 1)
    learned = learn_law(x, u, 0.0)
    assert isinstance(learned, LawNearby)
    (form,) = learned.forms(np.array([0.1, 0.2]))
    assert form.at(np.array([[0.1, 0.2]]))[0].ravel() == pytest.approx(
        [np.sin(0.3), np.cos(0.4)], abs=0.05
    )
    assert isinstance(learn_law(x, law(x), 0.01), LawNearby)
    assert learn_law(x[:5], u[:5], 0.0) is None
    assert UNKNOWN < 0


@pytest.mark.slow
def test_what_was_heard_whole_is_left_alone(run: Run) -> None:
    for step in infer(run, heard_by(run, View())):
        assert step.samples is not None
        assert step.samples.shape == (1, 2)
        assert step.samples[0] == pytest.approx(true_gauges(run, step.transition.k), abs=1e-9)


@pytest.mark.slow
def test_a_lost_state_is_found_again_from_the_offer_made_in_it(run: Run) -> None:
    right, covered, sharp = 0, 0, 0
    steps = range(300, 500, 8)
    for k in steps:
        inferred = {s.transition.k: s for s in infer(run, without(run, (Measurement, k)))}
        for j in (k - 1, k):
            samples, true = inferred[j].samples, true_gauges(run, j)
            assert samples is not None
            right += int(samples.mean(axis=0).argmin() == true.argmin())
            low, high = samples.min(axis=0) - 0.01, samples.max(axis=0) + 0.01
            covered += bool(((low <= true) & (true <= high)).all())
            sharp += bool((samples.std(axis=0) < 0.01).all())
    of = 2 * len(steps)
    assert right >= 0.85 * of  # where the candidates coincide there is no right
    assert covered >= 0.85 * of
    assert sharp >= 0.15 * of  # coinciding candidates tell one coordinate only


def test_a_lost_offer_is_found_again_from_the_state(run: Run) -> None:
    exact = 0
    steps = range(300, 500, 8)
    for k in steps:
        inferred = {s.transition.k: s for s in infer(run, without(run, (Offer, k)))}
        samples, true = inferred[k].samples, true_gauges(run, k)
        assert samples is not None
        exact += bool((np.abs(samples - true).max(axis=1) < 1e-6).any())
    assert exact >= 0.85 * len(steps)


def test_what_cannot_be_bridged_is_said_to_be_unknown(run: Run) -> None:
    offers = heard_by(run, View(view="offers"))
    assert all(s.samples is None for s in infer(run, offers))
    lost = [(Measurement, k) for k in range(300, 360)]
    steps = {s.transition.k: s for s in infer(run, without(run, *lost))}
    assert steps[330].samples is None
    assert steps[290].samples is not None
    assert infer(run, []) == []


def test_noise_spreads_the_samples_about_the_truth(run: Run) -> None:
    view = View(noise=0.01, seed=1)
    steps = infer(run, heard_by(run, view), noise=0.01)
    errors, spreads = [], []
    for step in steps[100:200]:
        assert step.samples is not None
        errors.append(step.samples.mean(axis=0) - true_gauges(run, step.transition.k))
        spreads.append(step.samples.std(axis=0))
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert 0.3 < rms / float(np.mean(spreads)) < 3
