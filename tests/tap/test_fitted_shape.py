"""In which shape to tell candidates apart: that of D_e, or one that the disturbance shows."""

from dataclasses import replace

import numpy as np
import pytest

from protocol.arrays import Array, Indices
from studies.secrecy.runs import simulate
from studies.secrecy.study import heard_by
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.inference.fitted_shape import likelier_shape, residuals_of
from tap_service.inference.front import Inference

A = np.array([[1.0, 0.1], [0.0, 0.95]])
B = np.array([[0.0], [0.5]])
TOLD = np.vstack([np.eye(2), -np.eye(2)]) / 0.8
"""H / h of a D_e that reaches 0.8 in each coordinate."""


def steps(
    widths: Array, count: int, seed: int, gap: float = 0.6
) -> tuple[list[Transition], Indices]:
    """Steps with d even over a box, two candidates, and which was applied."""
    draw = np.random.default_rng(seed)
    out, applied = [], draw.integers(2, size=count)
    for k, b in enumerate(applied.tolist()):
        x, middle = draw.normal(size=2), draw.normal()
        u = middle + gap * np.array([-0.5, 0.5])
        after = A @ x + B[:, 0] * u[b] + draw.uniform(-widths, widths)
        candidates = tuple((one,) for one in u.tolist())
        out.append(Transition("s", k, tuple(x.tolist()), candidates, 0, tuple(after.tolist())))
    return out, applied


@pytest.mark.parametrize("count", [20, 100, 1000])
@pytest.mark.parametrize("seed", range(5))
def test_a_multiple_of_d_e_is_measured_in_d_e(count: int, seed: int) -> None:
    heard, _ = steps(np.array([0.1, 0.1]), count, seed)
    shape = likelier_shape(TOLD, A, B, heard)
    assert shape.told is None
    assert (shape.rows == TOLD).all()


@pytest.mark.parametrize("name", ["packed", "packed-quadruple-tank", "sustained"])
@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_the_shipped_plants_are_measured_in_d_e(name: str, loss: float) -> None:
    run = simulate(320, 5, name=name, payloads=[b"Go on now."])
    k = run.scenario.knowledge()
    told = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
    heard = heard_by(run, View(seed=5, loss=loss))
    shape = likelier_shape(told, np.array(k.A), np.array(k.B), heard)
    assert shape.told is None


@pytest.mark.parametrize("seed", range(5))
def test_a_set_of_another_shape_is_found_and_orders_the_candidates(seed: int) -> None:
    """A coordinate that tells nothing reaches four times as far: D_e's shape errs in a third."""
    heard, applied = steps(np.array([0.4, 0.1]), 200, seed)
    shape = likelier_shape(TOLD, A, B, heard)
    residuals = residuals_of(A, B, heard)
    assert ((residuals @ TOLD.T).max(axis=2).argmin(axis=1) != applied).mean() > 0.1
    gauges = (residuals @ shape.rows.T).max(axis=2)
    assert (gauges.argmin(axis=1) == applied).all()
    reach = 1 / shape.rows[:2].max(axis=1)
    assert reach[0] / reach[1] == pytest.approx(4, rel=0.1)
    # what D_e holds is at most 1, and what it does not hold is no longer possible
    inside = (residuals @ TOLD.T).max(axis=(1, 2)) <= 1
    assert inside.any()
    bounded = shape.gauges(residuals).max(axis=1)
    assert (bounded[inside] <= 1).all()
    far = residuals * 5
    outside = (far @ TOLD.T).max(axis=(1, 2)) > 1
    assert outside.any()
    told = shape.gauges(far)
    assert (np.isinf(told.max(axis=1)) == outside).all()
    assert (told.argmin(axis=1) == (far @ shape.rows.T).max(axis=2).argmin(axis=1)).all()


def test_of_few_steps_nothing_is_learned() -> None:
    heard, _ = steps(np.array([0.4, 0.1]), 15, 1)
    assert likelier_shape(TOLD, A, B, heard).told is None


def test_near_ties_are_told_apart_in_the_widths_that_its_own_decisions_leave() -> None:
    """The set reaches hardly less far where the input decides, too little to be another shape."""
    width, wrong = 0.098, np.zeros(2, int)
    for seed in range(5):
        draw, heard = np.random.default_rng(seed + 100), []
        before, applied = steps(np.array([0.1, 0.0]), 600, seed, gap=2.0001 * width / B[1, 0])
        for t in before:
            assert t.x_next is not None
            after = t.x_next[0], t.x_next[1] + float(draw.choice([-width, width]))
            heard.append(replace(t, x_next=after))
        residuals = residuals_of(A, B, heard)
        for i, rows in enumerate((TOLD, likelier_shape(TOLD, A, B, heard).rows)):
            wrong[i] += ((residuals @ rows.T).max(axis=2).argmin(axis=1) != applied).sum()
    assert wrong[0] >= 10
    assert wrong[1] <= 2  # the step that reaches farthest may be such a tie itself


def test_a_tie_that_no_test_agrees_on_leaves_the_threshold_known() -> None:
    """Where candidates coincide one is as near as the other: D_e is still a multiple of D_c."""
    run = simulate(300, 11, name="sustained", payloads=[b"Go."])
    k = run.scenario.knowledge()
    told = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
    heard = heard_by(run, View())
    assert likelier_shape(told, np.array(k.A), np.array(k.B), heard).told is not None
    low, high = Inference(k).infer(heard).among
    assert low < 1 / run.scenario.secrecy.alpha < high < 1.01 * low
