"""Inference where outputs alone are read: which steps of a session the two ends lost."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from protocol.arrays import Array, Integers
from tap_service.capture.transcript import Transition, transitions_in_a_row
from tap_service.inference.inferred import Inferred, InferredStep
from tap_service.inference.opening import AT_FIRST, Known, Opening, lost_after
from tap_service.inference.output_model import LOST, OutputModel

TRAJECTORIES: Final = 64
"""Numbers of lost steps, and candidates applied, that `text` weighs as equally likely ones."""


def inferred(model: OutputModel, size: int, transitions: Sequence[Transition]) -> Inferred:
    """A transcript as `text` reads it: how many steps were lost is a trajectory of 64.

    Of a session's first, half of them lose one, a quarter two, and so on; after a stretch of missed
    steps as many lose one as it was long, and half of these another.

    Where her own receiver adds noise, as many go along a candidate as it is likely; which ones is
    drawn for each step. Elsewhere all go along the likeliest: the readings tell it, and a filter
    that takes a bounded disturbance for a normal one is less sure than it is right.
    """
    rng = np.random.default_rng(0)
    steps = []
    for run in transitions_in_a_row(transitions):
        opening = Opening(model, size)
        known = [one for t in run for one in opening.take(t)[0]] + opening.flush()
        for one in known:
            lost = _lost(lost_after(one.again)) if one.again else 1 + _lost(AT_FIRST)
            samples = _samples(one, _applied(one, rng, noisy=model.noise > 0), size, lost)
            steps.append(InferredStep(one.transition, samples))
    return Inferred(steps, (0.0, 1.0))


def _lost(more: float) -> Integers:
    """Steps lost in each trajectory: ``more`` of them lose one, half of these another."""
    at = (np.arange(TRAJECTORIES) + 0.5) / TRAJECTORIES
    lost = np.floor(1 + np.log2(more / at)).clip(0, LOST - 1)
    return lost.astype(int)


def _applied(one: Known, rng: np.random.Generator, *, noisy: bool) -> Integers | None:
    """The candidate applied in each trajectory, one for all where there is no doubt."""
    if one.symbol is None:
        return None
    if not noisy:
        return np.array([one.symbol])
    at = (np.arange(TRAJECTORIES) + 0.5) / TRAJECTORIES
    share = np.cumsum(one.shares)
    symbols: Integers = np.searchsorted(share, at * share[-1])
    if (symbols == symbols[0]).all():
        return symbols[:1]
    rng.shuffle(symbols)
    return symbols


def _samples(one: Known, applied: Integers | None, size: int, lost: Integers) -> Array | None:
    """Gauges that agree for all thresholds between 0 and 1, or for none."""
    if applied is None:
        return None
    agrees = 1.0 - np.eye(size)[applied]
    if not one.doubtful:
        return agrees
    out = np.repeat(agrees, len(lost) // len(agrees), axis=0)
    out[lost > one.place] = 1.0
    return out
