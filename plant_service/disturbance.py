"""What the simulated plant suffers: d(k) from ``n`` uniform numbers, whatever its kind."""

import math
from collections.abc import Sequence

from protocol.scenario import Disturbance
from protocol.vectors import Vector


def disturbance(spec: Disturbance, k: int, uniforms: Sequence[float]) -> Vector:
    """d(k), the disturbance of step ``k``.

    Parameters
    ----------
    spec : Disturbance
    k : int
        The step; only ``sinusoid`` depends on it.
    uniforms : sequence of float, shape (n,)
        In [0, 1): all the randomness there is. Every kind takes them, so that draws stay aligned.

    Returns
    -------
    tuple of float, shape (n,)
    """
    widths = spec.half_widths
    if spec.kind == "uniform":
        return tuple([(2.0 * v - 1.0) * w for v, w in zip(uniforms, widths, strict=True)])
    if spec.kind == "corners":
        return tuple(w if v >= 0.5 else -w for v, w in zip(uniforms, widths, strict=True))
    if spec.kind == "constant":
        return tuple(spec.bias * w for w in widths)
    if spec.kind == "sinusoid":
        phase = math.sin(2.0 * math.pi * k / spec.cycle_steps)
        return tuple(phase * w for w in widths)
    from scipy.special import ndtr, ndtri

    if spec.kind == "gaussian":
        standard = [float(ndtri(max(v, 2.0**-54))) for v in uniforms]
    else:
        low = float(ndtr(-1.0 / spec.deviation))
        span = 1.0 - 2.0 * low
        standard = [float(ndtri(low + span * v)) for v in uniforms]
    return tuple(spec.deviation * w * z for z, w in zip(standard, widths, strict=True))
