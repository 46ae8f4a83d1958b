"""Identification of the plant by someone who does not know which candidate was applied.

From states and offers alone: x(k+1) = A x(k) + B u_b(k) + o + d(k), with the choice b unknown at
every step. The coin is fair, so that a regression on the candidates' mean starts near the truth;
then each step's choice is the candidate that fits best, the regression is repeated with it, and so
on until nothing changes. A bounded disturbance fills its set to the edge, so at the end the model
with the smallest largest residual is taken: its error falls like 1/N, where that of least squares
falls like 1/sqrt(N). Where the residuals look Gaussian, least squares stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array

Choice = NDArray[np.intp]

ROUNDS: Final = 100
"""Rounds of choosing and fitting at most."""

SETTLED: Final = 1e-7
"""Gain in spread below which a further round is not worth it."""

FLAT: Final = 2.3
"""Kurtosis below which residuals count as bounded: 1.8 is uniform, 3 is Gaussian."""

GAUSSIAN_EDGE: Final = 3.0
"""Standard deviations that stand for the edge of a disturbance without one."""


@dataclass(frozen=True, slots=True)
class ModelFit:
    """An identified model.

    Parameters
    ----------
    A, B : array, shapes (n, n) and (n, m)
    offset : array, shape (n,)
        Mean of the disturbance.
    widths : array, shape (n,)
        Half-widths of the smallest box about the offset that holds every residual.
    choice : array of int, shape (N,)
        The candidate that fits each step best.
    spread : float
        Sum of squared residuals over the steps: what the starts are compared by.
    """

    A: Array
    B: Array
    offset: Array
    widths: Array
    choice: Choice
    spread: float


def identify(
    x: Array,
    candidates: Array,
    x_next: Array,
    starts: Sequence[tuple[Array, Array]] = (),
    *,
    refine: bool = True,
) -> ModelFit:
    """Identify A, B, the offset and the disturbance's support.

    Parameters
    ----------
    x, x_next : array, shape (N, n)
    candidates : array, shape (N, M, m)
    starts : sequence of (A, B)
        Models to start from, beside the regression on the candidates' mean.
    refine : bool
        Whether to end with the smallest largest residual; costs a linear program a state.

    Returns
    -------
    Fit
        Of the start with the smallest spread.
    """
    n = x.shape[1]
    mean = candidates.mean(axis=1)
    first = _regress(np.hstack([x, mean, np.ones((len(x), 1))]), x_next)
    mirrored = first.copy()
    mirrored[n:-1] *= -1
    begins = [first, mirrored]
    for A, B in starts:
        begins.append(np.vstack([A.T, B.T, np.zeros((1, n))]))
    fits = [_expect(x, candidates, x_next, theta) for theta in begins]
    theta, widths, spread = min(fits, key=lambda fit: fit[2])
    choice = _choose(x, candidates, x_next, theta, widths)
    steps = np.arange(len(x))
    rounds = ROUNDS if refine and len(x) > 2 * len(theta) else 0
    for _ in range(rounds):
        before = choice
        phi = np.hstack([x, candidates[steps, choice], np.ones((len(x), 1))])
        theta, widths = _refine(phi, x_next, theta)
        choice = _choose(x, candidates, x_next, theta, widths)
        if (choice == before).all():
            break
    if not rounds:
        widths = np.abs(_residuals(x, candidates, x_next, theta)[steps, choice]).max(axis=0)
    return ModelFit(
        A=theta[:n].T.copy(),
        B=theta[n:-1].T.copy(),
        offset=theta[-1].copy(),
        widths=np.maximum(widths, 1e-12),
        choice=choice,
        spread=spread,
    )


def _regress(phi: Array, y: Array, weight: Array | None = None) -> Array:
    """Least squares with a trace of a ridge, so that directions never seen stay at zero."""
    scale = np.maximum(np.abs(phi).max(axis=0), 1e-9)
    scaled = phi / scale
    left = scaled if weight is None else scaled * weight[:, None]
    gram = left.T @ scaled + 1e-9 * len(phi) * np.eye(phi.shape[1])
    found: Array = np.linalg.solve(gram, left.T @ y) / scale[:, None]
    return found


def _residuals(x: Array, candidates: Array, x_next: Array, theta: Array) -> Array:
    """Residual of every candidate, shape (N, M, n)."""
    n = x.shape[1]
    base = x_next - x @ theta[:n] - theta[-1]
    found: Array = base[:, None, :] - candidates @ theta[n:-1]
    return found


def _choose(x: Array, candidates: Array, x_next: Array, theta: Array, widths: Array) -> Choice:
    """The candidate with the smallest residual in the shape of ``widths``."""
    size = (np.abs(_residuals(x, candidates, x_next, theta)) / widths).max(axis=2)
    found: Choice = size.argmin(axis=1)
    return found


def _expect(x: Array, candidates: Array, x_next: Array, theta: Array) -> tuple[Array, Array, float]:
    """Expectation maximisation over the choices; model, deviations and spread."""
    steps, size, _ = candidates.shape
    phi = np.concatenate(
        [np.hstack([x, candidates[:, i], np.ones((steps, 1))]) for i in range(size)]
    )
    y = np.tile(x_next, (size, 1))
    residual = _residuals(x, candidates, x_next, theta)
    deviation = np.sqrt((residual**2).min(axis=1).mean(axis=0)) + 1e-9
    spread = np.inf
    for _ in range(ROUNDS):
        exponent = -0.5 * ((residual / deviation) ** 2).sum(axis=2)
        top = exponent.max(axis=1, keepdims=True)
        weight = np.exp(exponent - top)
        total = weight.sum(axis=1, keepdims=True)
        before, spread = spread, float(np.log(deviation).sum() - (top + np.log(total)).mean())
        weight /= total
        if before - spread < SETTLED:
            break
        theta = _regress(phi, y, weight.T.ravel())
        residual = _residuals(x, candidates, x_next, theta)
        deviation = np.sqrt((weight[:, :, None] * residual**2).sum(axis=(0, 1)) / steps) + 1e-9
    return theta, deviation, spread


def _refine(phi: Array, y: Array, theta: Array) -> tuple[Array, Array]:
    """For each state, the smallest largest residual, where the residuals have an edge."""
    from scipy.optimize import linprog

    residual = y - phi @ theta
    out, widths = theta.copy(), np.abs(residual).max(axis=0)
    rows, columns = phi.shape
    for j in range(y.shape[1]):
        r = residual[:, j] - residual[:, j].mean()
        variance = float((r**2).mean())
        if variance <= 0:
            continue
        kurtosis = float((r**4).mean()) / variance**2
        if kurtosis > FLAT:
            widths[j] = GAUSSIAN_EDGE * np.sqrt(variance)
            continue
        # only the rows near the edge can bind: solve on these, then check the others
        near = np.argsort(-np.abs(residual[:, j]))[: max(200, rows // 5)]
        for _ in range(6):
            bound = np.vstack(
                [
                    np.hstack([-phi[near], -np.ones((len(near), 1))]),
                    np.hstack([phi[near], -np.ones((len(near), 1))]),
                ]
            )
            limit = np.concatenate([-y[near, j], y[near, j]])
            cost = np.zeros(columns + 1)
            cost[-1] = 1.0
            found = linprog(
                cost,
                A_ub=bound,
                b_ub=limit,
                bounds=[(None, None)] * columns + [(0, None)],
                method="highs",
            )
            if found.status != 0 or found.x is None:
                break
            left = np.abs(y[:, j] - phi @ found.x[:-1])
            beyond = np.flatnonzero(left > found.x[-1] * (1 + 1e-9))
            if not len(beyond):
                out[:, j], widths[j] = found.x[:-1], found.x[-1]
                break
            near = np.union1d(near, beyond)
    return out, widths
