"""What dither on a plant's inputs costs: the price of an alphabet's bits."""

from dataclasses import dataclass

import numpy as np

from protocol.arrays import Array


@dataclass(frozen=True)
class Price:
    """What dither of variance 1 on each input adds, where no constraint is active.

    Parameters
    ----------
    state, input : tuple of float, length m
        kx and ku: mean of x'x and of u'u, from the Lyapunov equation of x+ = (A + B K) x + B p.
    """

    state: tuple[float, ...]
    input: tuple[float, ...]


def added(A: Array, B: Array, K: Array, covariance: Array) -> tuple[float, float]:
    """What dither of this covariance, shape (m, m), adds to the means of x'x and u'u."""
    from scipy.linalg import solve_discrete_lyapunov

    S = solve_discrete_lyapunov(A + B @ K, B @ covariance @ B.T)
    return float(np.trace(S)), float(np.trace(K @ S @ K.T) + np.trace(covariance))


def dither_price(A: Array, B: Array, K: Array) -> Price:
    """kx and ku of the loop u = K x + p, of p on each input alone."""
    units = np.eye(B.shape[1])
    pairs = [added(A, B, K, np.outer(unit, unit)) for unit in units]
    return Price(tuple(x for x, _ in pairs), tuple(u for _, u in pairs))
