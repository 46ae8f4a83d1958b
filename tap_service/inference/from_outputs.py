"""Inference where outputs alone are read: which first steps of a session the two ends lost."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.front import Inferred
from tap_service.inference.gap_smoother import InferredStep
from tap_service.inference.opening import Known, Opening
from tap_service.inference.output_model import LOST, OutputModel

TRAJECTORIES: Final = 64
"""Numbers of lost steps that `text` weighs, as equally likely ones."""


def inferred(model: OutputModel, size: int, transitions: Sequence[Transition]) -> Inferred:
    """A transcript as `text` reads it: how many first steps were lost is a trajectory of 64.

    Half of them lose one step, a quarter two, and so on.
    """
    lost = np.minimum(1 + np.floor(-np.log2((np.arange(TRAJECTORIES) + 0.5) / TRAJECTORIES)), LOST)
    steps = []
    for run in steps_in_a_row(transitions):
        opening = Opening(model)
        known = [one for t in run for one in opening.take(t)[0]] + opening.flush()
        steps += [InferredStep(one.transition, _samples(one, size, lost)) for one in known]
    return Inferred(steps, (0.0, 1.0))


def _samples(one: Known, size: int, lost: Array) -> Array | None:
    """Gauges that agree for all thresholds between 0 and 1, or for none."""
    if one.symbol is None:
        return None
    agrees = np.array([one.row(size)])
    if not one.doubtful:
        return agrees
    out = np.repeat(agrees, len(lost), axis=0)
    out[lost > one.place] = 1.0
    return out
