"""Identification from states and offers alone, with the applied candidate unknown."""

import numpy as np
import pytest

from tap_service.inference.identification import identify

RNG_STEPS = 600


def data(seed: int, n: int, m: int, size: int, kind: str = "uniform") -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    A = 0.5 * np.eye(n) + 0.2 * rng.standard_normal((n, n)) / n
    B = rng.standard_normal((n, m))
    K = 0.2 * rng.standard_normal((m, n))
    x = np.empty((RNG_STEPS + 1, n))
    x[0] = rng.standard_normal(n)
    u = np.empty((RNG_STEPS, size, m))
    choice = rng.integers(size, size=RNG_STEPS)
    for k in range(RNG_STEPS):
        u[k] = x[k] @ K.T + rng.uniform(-1, 1, (size, m)) + 0.1 * np.sin(x[k, 0]) ** 2
        d = rng.uniform(-0.1, 0.1, n) if kind == "uniform" else 0.05 * rng.standard_normal(n)
        x[k + 1] = A @ x[k] + B @ u[k, choice[k]] + d
    return A, B, x[:-1], u, x[1:], choice


@pytest.mark.parametrize(("n", "m", "size"), [(1, 1, 2), (2, 1, 2), (3, 2, 3), (4, 2, 4)])
def test_model_support_and_choices_are_found(n: int, m: int, size: int) -> None:
    A, B, x, u, x_next, choice = data(n, n, m, size)
    fit = identify(x, u, x_next)
    assert np.allclose(fit.A, A, atol=0.02)
    assert np.allclose(fit.B, B, atol=0.02)
    assert fit.widths == pytest.approx(np.full(n, 0.1), rel=0.1)
    assert np.abs(fit.offset).max() < 0.02
    assert (fit.choice == choice).mean() > 0.9


def test_the_smallest_largest_residual_beats_least_squares_for_a_bounded_disturbance() -> None:
    worse = 0
    for seed in range(5):
        A, B, x, u, x_next, _ = data(10 + seed, 2, 1, 2)
        errors = []
        for refine in (True, False):
            fit = identify(x, u, x_next, refine=refine)
            errors.append(max(np.abs(fit.A - A).max(), np.abs(fit.B - B).max()))
        worse += errors[0] >= errors[1]
    assert worse <= 1


def test_a_gaussian_disturbance_keeps_least_squares() -> None:
    A, B, x, u, x_next, _ = data(3, 2, 1, 2, "gaussian")
    fit = identify(x, u, x_next)
    assert np.allclose(fit.A, A, atol=0.03)
    assert np.allclose(fit.B, B, atol=0.03)
    assert fit.widths == pytest.approx(np.full(2, 0.15), rel=0.2)


def test_a_steady_disturbance_is_the_offset() -> None:
    _, _, x, u, x_next, _ = data(4, 2, 1, 2)
    fit = identify(x, u, x_next + np.array([0.3, -0.2]))
    moved = fit.offset - identify(x, u, x_next).offset
    assert moved == pytest.approx([0.3, -0.2], abs=0.02)


@pytest.mark.parametrize("error", [0.1, 0.3, 0.5])
def test_a_wrong_model_to_start_from_changes_nothing(error: float) -> None:
    """Twelve transitions suffice: hence the study's conditions with a wrong model agree."""
    A, B, x, u, x_next, _ = data(5, 2, 1, 2)
    signs = np.random.default_rng(6).choice((-error, error), (2, 3))
    wrong = A * (1 + signs[:, :2]), B * (1 + signs[:, 2:])
    for steps in (12, RNG_STEPS):
        told = identify(x[:steps], u[:steps], x_next[:steps], [wrong])
        untold = identify(x[:steps], u[:steps], x_next[:steps])
        assert np.allclose(told.A, untold.A, atol=1e-6)
        assert np.allclose(told.B, untold.B, atol=1e-6)


def test_few_steps_give_a_finite_answer() -> None:
    _, _, x, u, x_next, _ = data(5, 2, 1, 2)
    for count in (1, 2, 5, 12):
        fit = identify(x[:count], u[:count], x_next[:count])
        assert np.isfinite(fit.A).all()
        assert np.isfinite(fit.B).all()
        assert (fit.widths > 0).all()
