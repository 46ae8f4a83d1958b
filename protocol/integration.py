"""One step of an ordinary differential equation."""

from collections.abc import Callable, Sequence

from protocol.vectors import Vector

Dynamics = Callable[[float, Sequence[float], Sequence[float]], Sequence[float]]


def runge_kutta_step(
    f: Dynamics, t_s: float, x: Sequence[float], u: Sequence[float], h_s: float
) -> Vector:
    """One step of the classical fourth-order method, u held.

    Parameters
    ----------
    f : callable
        (t, x, u) -> dx/dt, shape (n,).
    t_s, h_s : float
        Time at the start, and the step.
    x, u : sequence of float, shapes (n,) and (m,)

    Returns
    -------
    tuple of float, shape (n,)
    """
    half = 0.5 * h_s
    a = f(t_s, x, u)
    b = f(t_s + half, tuple([v + half * s for v, s in zip(x, a, strict=True)]), u)
    c = f(t_s + half, tuple([v + half * s for v, s in zip(x, b, strict=True)]), u)
    d = f(t_s + h_s, tuple([v + h_s * s for v, s in zip(x, c, strict=True)]), u)
    sixth = h_s / 6.0
    slopes = zip(x, a, b, c, d, strict=True)
    return tuple([float(v + sixth * (p + 2.0 * q + 2.0 * r + s)) for v, p, q, r, s in slopes])
