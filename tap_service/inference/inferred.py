"""Transitions as they were inferred: what a smoother hands on."""

from dataclasses import dataclass

from protocol.arrays import Array
from tap_service.capture.transcript import Transition


@dataclass(slots=True)
class InferredStep:
    """One transition as it was inferred: equally likely gauges, and the cipher if it was heard.

    ``samples`` has shape (S, M); S = 1 where nothing is uncertain; None where nothing is known.
    """

    transition: Transition
    samples: Array | None


@dataclass(frozen=True)
class Inferred:
    """The steps as inferred.

    Parameters
    ----------
    steps : list of InferredStep
    among : tuple of float
        t_c from and to, in units of D_e.
    """

    steps: list[InferredStep]
    among: tuple[float, float]


def thresholds_above(support: float) -> tuple[float, float]:
    """Thresholds of a defender, by the gauge of the largest disturbance."""
    return 0.95 * support, min(3.0 * support, 1.0)
