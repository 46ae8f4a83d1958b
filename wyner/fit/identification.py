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


def identify(x: ArrayLike, u: ArrayLike, x_next: ArrayLike) -> FittedModel:
    """Fit A and B to T transitions by ordinary least squares.

    Parameters
    ----------
    x, u, x_next : array, shapes (T, n), (T, m), (T, n)
        Deviations; rows may come from many sessions.

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
        what = f"state {j + 1}" if j < n else f"input {j - n + 1}"
        raise FitError(f"{what} is zero throughout: the plant was not excited")
    singular = np.linalg.svd(Z / lengths, compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
    if condition > LARGEST_CONDITION:
        raise FitError(
            f"states and inputs are dependent (condition {condition:.3g}): excite the plant more"
        )
    scaled, *_ = np.linalg.lstsq(Z / lengths, Y, rcond=None)
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
