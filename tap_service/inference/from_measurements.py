"""What was applied, from states alone, for one who knows the control policy.

The law's candidates follow from the state, as far as its facets are known, but for the width of
D_c; the true one is that under which the nearest candidate leaves the least to the disturbance. So
the key symbols are named without an offer. The message is not: no cipher symbol was heard.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition
from tap_service.inference.gap_smoother import InferredStep
from tap_service.inference.policy import KnownLaw

WIDTHS: Final = tuple(np.geomspace(1 / 64, 1.0, 209).tolist())
"""Widths of D_c over D_e that are tried, two in a hundred apart."""

BULK: Final = 0.95
"""Share of the steps whose disturbance counts: some states lie outside the terminal set."""


def infer_from_measurements(
    A: Array, B: Array, shape: Array, law: KnownLaw, transitions: Sequence[Transition]
) -> list[InferredStep]:
    """Gauges of transitions of which no offer was heard.

    Parameters
    ----------
    A, B : array
        Her model.
    shape : array, shape (rows, n)
        H / h of D_e: the gauge of v is the largest entry of ``shape @ v``.
    """
    pairs = [
        (i, t.x, t.x_next)
        for i, t in enumerate(transitions)
        if t.x is not None and t.x_next is not None
    ]
    samples: list[Array | None] = [None] * len(transitions)
    if pairs:
        x, x_next = np.array([p[1] for p in pairs]), np.array([p[2] for p in pairs])
        moved = x_next - x @ A.T

        def gauges(width: float) -> Array:
            residual = moved[:, None] - law.offers(x, width) @ B.T
            out: Array = np.maximum((residual @ shape.T).max(axis=2), 0.0)
            return out

        def left(width: float) -> float:
            return float(np.quantile(gauges(width).min(axis=1), BULK))

        width = min(WIDTHS, key=left) if law.facets else 1.0
        for (i, _, _), row in zip(pairs, gauges(width), strict=True):
            samples[i] = row[None]
    return [InferredStep(t, s) for t, s in zip(transitions, samples, strict=True)]
