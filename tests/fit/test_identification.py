"""A and B from data: exact without noise, within their errors with it, refused without either."""

import numpy as np
import pytest

from wyner.fit.identification import FitError, identify

A = np.array([[1.0, 0.1], [-0.2, 0.9]])
B = np.array([[0.005], [0.1]])


def data(steps: int, noise: float, seed: int = 3) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    x, u = np.zeros((steps + 1, 2)), rng.uniform(-1, 1, (steps, 1))
    for k in range(steps):
        x[k + 1] = A @ x[k] + B @ u[k] + noise * rng.uniform(-1, 1, 2)
    return x[:-1], u, x[1:]


def test_without_noise_the_model_is_exact() -> None:
    model = identify(*data(60, 0.0))
    assert np.abs(model.A - A).max() < 1e-12
    assert np.abs(model.B - B).max() < 1e-12
    assert model.errors.max() < 1e-12
    assert model.dead == []


def test_with_noise_the_standard_errors_are_honest() -> None:
    """Of 6 entries in 200 fits (seeds 0 to 199) about 95 in 100 lie within 1.96 errors."""
    within = []
    for seed in range(200):
        model = identify(*data(150, 0.02, seed))
        away = np.abs(np.hstack([model.A, model.B]) - np.hstack([A, B]))
        within.append(away <= 1.96 * model.errors)
    assert 0.92 <= np.mean(within) <= 0.98


@pytest.mark.parametrize(
    ("x", "u", "says"),
    [
        (np.ones((3, 2)), np.ones((3, 1)), "got 3 transitions, expected more than 3"),
        (np.random.default_rng(1).random((9, 2)), np.zeros((9, 1)), "input u_1 is zero throughout"),
        (
            np.zeros((9, 2)),
            np.ones((9, 1)),
            "x_1 is zero throughout: no input has an effect",
        ),
        (
            np.random.default_rng(1).random((9, 1)) * [1.0, 2.0],
            np.random.default_rng(2).random((9, 1)),
            "states and inputs are dependent",
        ),
    ],
)
def test_data_that_determine_nothing(x: np.ndarray, u: np.ndarray, says: str) -> None:
    with pytest.raises(FitError, match=says):
        identify(x, u, x)
