"""A and B by least squares from transitions of a plant."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from protocol.arrays import Array


class FitError(Exception):
    """Data from which no model follows; one line that says what is missing."""


@dataclass(frozen=True, eq=False)
class FittedModel:
    """x+ = A x + B u + d, and how well the data determine it.

    Parameters
    ----------
    A, B : array, shapes (n, n) and (n, m)
    residuals : array, shape (T, n)
        x+ - A x - B u of the data.
    errors : array, shape (n, n + m)
        Standard error of each entry of [A B], from the residuals' variance.
    condition : float
        Condition number of the regressors, each scaled to unit length.
    """

    A: Array
    B: Array
    residuals: Array
    errors: Array
    condition: float


LARGEST_CONDITION = 1e6
"""Regressors that are nearer to dependent than this determine nothing."""

WITHIN = 4.0
"""Standard errors that count as within the error: by chance one number in 16,000 is beyond."""

ROUNDED = 1e-12
"""Share of a state that is rounding."""


def identify(
    x: ArrayLike, u: ArrayLike, x_next: ArrayLike, instruments: ArrayLike | None = None
) -> FittedModel:
    """Fit A and B to T transitions by least squares, or by instruments where readings are noisy.

    Noise of a reading is in x and in x+ both, so that least squares would find too small an A.
    The reading before knows nothing of it.

    Parameters
    ----------
    x, u, x_next : array, shapes (T, n), (T, m), (T, n)
        Deviations; rows may come from many sessions.
    instruments : array, shape (T, n), optional
        The reading before each x.

    Returns
    -------
    Model

    Raises
    ------
    FitError
        With too few transitions, or when the inputs did not excite the plant.
    """
    X, U, Y = (np.asarray(v, dtype=float) for v in (x, u, x_next))
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
    singular = np.linalg.svd(Z / lengths, compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
    if condition > LARGEST_CONDITION:
        raise FitError(
            f"states and inputs are dependent (condition {condition:.3g}): excite the plant more"
        )
    if instruments is None:
        scaled, *_ = np.linalg.lstsq(Z / lengths, Y, rcond=None)
    else:
        known = np.hstack([np.asarray(instruments, dtype=float), U]) / lengths
        scaled = np.linalg.solve(known.T @ (Z / lengths), known.T @ Y)
    theta = (scaled / lengths[:, None]).T
    residuals = Y - Z @ theta.T
    spread = np.linalg.inv((Z / lengths).T @ (Z / lengths)).diagonal() / lengths**2
    variance = (residuals**2).sum(axis=0) / (T - n - m)
    return FittedModel(
        A=theta[:, :n],
        B=theta[:, n:],
        residuals=residuals,
        errors=np.sqrt(np.outer(variance, spread)),
        condition=condition,
    )


def inputs_without_effect(model: FittedModel, x: ArrayLike, u: ArrayLike) -> list[int]:
    """Inputs whose column of B is within its error, from 0.

    Parameters
    ----------
    model : FittedModel
    x, u : array, shapes (T, n) and (T, m)
        The data of the fit. They tell what a number of B would have to be to be more than rounding.
    """
    X, U = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
    least = ROUNDED * np.outer(np.sqrt((X**2).mean(axis=0)), 1 / np.sqrt((U**2).mean(axis=0)))
    errors = model.errors[:, X.shape[1] :]
    dead = (np.abs(model.B) <= np.maximum(WITHIN * errors, least)).all(axis=0)
    return [int(j) for j in np.flatnonzero(dead)]
