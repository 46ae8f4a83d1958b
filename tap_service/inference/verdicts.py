"""How likely each verdict of a step is by its inferred gauges, and whether the step was made."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition
from tap_service.inference.inferred import InferredStep

LIKE_ALONE: Final = 10.0
"""Trajectories that are added, where a step is looked at after another, as it is alone."""

DOUBT: Final = 1e-4
"""Probability that a step's verdict is another where nothing seems to speak for it."""

NEAREST: Final = 1e-4
"""Trajectories that are added for each drawn, in which its nearest candidate was agreed."""

PSEUDO: Final = 0.25
"""Trajectories that are added to those drawn, spread over all verdicts."""


def verdicts_of(
    steps: Sequence[InferredStep], among: tuple[float, float], size: int, *, certain: bool
) -> tuple[Array, Array]:
    """Probability of each step's verdict (none, symbol 0, 1, ...), alone and after the last one.

    Parameters
    ----------
    steps : sequence of InferredStep
    among : tuple of float
        t_c from and to, in units of D_e, evenly.
    size : int
        M.
    certain : bool
        Whether every step agrees.

    Returns
    -------
    alone : array, shape (K, 1 + M)
    after : array, shape (K, M, 1 + M)
        Where the step before agreed on each symbol: trajectories are drawn over several steps, so
        that what one step was says something of the next.
    """
    shares = [_shares(step.samples, among, size, certain=certain) for step in steps]
    alone = np.zeros((len(steps), 1 + size))
    for i, share in enumerate(shares):
        if share is None:
            continue
        alone[i] = share.sum(axis=0)
        more = DOUBT if len(share) == 1 else PSEUDO
        alone[i, 1 if certain else 0 :] += more / (size + 1)
        # if one was agreed all the same, then the nearest
        samples = steps[i].samples
        assert samples is not None
        alone[i, 1:] += NEAREST * np.bincount(samples.argmin(axis=1), minlength=size)
        alone[i] /= alone[i].sum()
    blind = np.array([share is None for share in shares], dtype=bool)
    seen = alone[~blind]
    agreed = 1.0 if certain else (float(seen[:, 1:].sum(axis=1).mean()) if len(seen) else 0.2)
    alone[blind, 0] = 1.0 - agreed
    alone[blind, 1:] = agreed / size
    after = np.repeat(alone[:, None], size, axis=1)
    for i, (before, share) in enumerate(pairwise(shares), 1):
        if before is None or share is None or len(before) != len(share) or len(share) == 1:
            continue
        together = before[:, 1:].T @ share + LIKE_ALONE * alone[i]
        after[i] = together / together.sum(axis=1, keepdims=True)
    return alone, after


def made_of(transitions: Sequence[Transition]) -> Array:
    """Probability that each step was made: that the plant took its offer, shape (K,).

    It is certain where a measurement said so. Elsewhere it is Bayes' rule: by how often the plant
    is known to have missed steps, and by whether she heard an offer. Of a missed step there may
    have been an offer that was lost or late, or none; either is taken for as likely. By offers
    alone nothing tells of a missed step, and each counts as made.
    """
    told = [t for t in transitions if t.applied]
    gaps = sum(t.k > before.k + 1 and not t.gap for before, t in pairwise(transitions))
    unheard = (sum(t.cipher is None for t in told) + 1) / (len(told) + 2)
    out = np.ones(len(transitions))
    for i, t in enumerate(transitions):
        if told and gaps and not t.applied:
            heard = t.cipher is not None
            made = len(told) * ((1 - unheard) if heard else unheard)
            out[i] = made / (made + gaps * ((1 - unheard) if heard else 1 + unheard) / 2)
    return out


def _shares(
    samples: Array | None, among: tuple[float, float], size: int, *, certain: bool
) -> Array | None:
    """Of each trajectory the probability of each verdict, shape (S, 1 + M)."""
    if samples is None:
        return None
    low, high = among
    choice = samples.argmin(axis=1)
    share = np.ones(len(choice))
    if not certain:
        ordered = np.sort(samples, axis=1)
        over = np.minimum(high, ordered[:, 1]) - np.maximum(low, ordered[:, 0])
        share = np.clip(over / max(high - low, 1e-12), 0.0, 1.0) * (ordered[:, -1] <= 1.0)
    out = np.zeros((len(choice), 1 + size))
    out[np.arange(len(choice)), 1 + choice] = share
    out[:, 0] = 1.0 - share
    return out
