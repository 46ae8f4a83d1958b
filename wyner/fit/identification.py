"""A and B by least squares from transitions of a plant."""

from dataclasses import dataclass

import numpy as np

from protocol.arrays import Array


class FitError(Exception):
    """Data from which no model follows; one line that says what is missing."""


@dataclass(frozen=True, eq=False)
class FittedModel:
    """x+ = A x + B u + d, and how well the data determine it.

    Parameters
    ----------
    A, B : array, shapes (n, n) and (n, m)
    errors : array, shape (n, n + m)
        Standard error of each entry of [A B], from the residuals' variance.
    condition : float
        Condition number of the regressors, each scaled to unit length.
    dead : list of int
        Inputs whose column of B is within its error, from 0.
    """

    A: Array
    B: Array
    errors: Array
    condition: float
    dead: list[int]


LARGEST_CONDITION = 1e6
"""Regressors that are nearer to dependent than this determine nothing."""

WITHIN = 4.0
"""Standard errors that count as within the error: by chance one number in 16,000 is beyond."""

ROUNDED = 1e-12
"""Share of a state that is rounding."""


def identify(x: Array, u: Array, x_next: Array, instruments: Array | None = None) -> FittedModel:
    """Fit A and B to transitions by least squares, or by instruments where readings are noisy.

    Noise of a reading is in x and in x+ both, so that least squares would find too small an A.
    The reading before knows nothing of it.

    Parameters
    ----------
    x, u, x_next : array, shapes (..., n), (..., m), (..., n)
        Deviations, of one session or many.
    instruments : array, shape (..., n), optional
        The reading before each x.

    Raises
    ------
    FitError
        With too few transitions, or when the inputs did not excite the plant.
    """
    X, U, Y = (v.reshape(-1, v.shape[-1]) for v in (x, u, x_next))
    T, n = X.shape
    m = U.shape[1]
    if n + m >= T:
        raise FitError(f"got {T} transitions, expected more than {n + m}, the states and inputs")
    Z = np.hstack([X, U])
    lengths = np.sqrt((Z * Z).sum(axis=0))
    if not lengths.all():
        j = int((lengths == 0).argmax())
        if j < n and lengths[n:].all():
            raise FitError(f"state x_{j + 1} is zero throughout: no input has an effect on it")
        what = f"state x_{j + 1}" if j < n else f"input u_{j - n + 1}"
        raise FitError(f"{what} is zero throughout: the plant was not excited")
    scaled = Z / lengths
    singular = np.linalg.svd(scaled, compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
    if condition > LARGEST_CONDITION:
        raise FitError(
            f"states and inputs are dependent (condition {condition:.3g}): excite the plant more"
        )
    if instruments is None:
        solved, *_ = np.linalg.lstsq(scaled, Y, rcond=None)
    else:
        known = np.hstack([instruments.reshape(-1, n), U]) / lengths
        solved = np.linalg.solve(known.T @ scaled, known.T @ Y)
    theta = (solved / lengths[:, None]).T
    variance = ((Y - Z @ theta.T) ** 2).sum(axis=0) / (T - n - m)
    spread = np.linalg.inv(scaled.T @ scaled).diagonal() / lengths**2
    errors = np.sqrt(np.outer(variance, spread))
    # What is rounding is no effect, however small its error.
    rounding = ROUNDED * np.outer(lengths[:n], 1 / lengths[n:])
    dead = (np.abs(theta[:, n:]) <= np.maximum(WITHIN * errors[:, n:], rounding)).all(axis=0)
    return FittedModel(
        A=theta[:, :n],
        B=theta[:, n:],
        errors=errors,
        condition=condition,
        dead=np.flatnonzero(dead).tolist(),
    )
