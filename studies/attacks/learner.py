"""What one matrix for all steps gives away: an eavesdropper who solves for it from two of them."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from controller_service.laws.base import CandidateLaw
from protocol.arrays import Array
from studies.attacks.attacked import Learner, SentAndOffered
from studies.attacks.defences import FULL, Words, turned

ANGLES: Final = 720
KEPT: Final = 6
ROUNDS: Final = 9
POINTS: Final = 21


def rotation_learner(law: CandidateLaw) -> Learner:
    """Finds the angle at which the law, which is public, offers what was offered; n = 2.

    Every turn of the sent measurement is a state that it may stand for, and has its own offer. Two
    steps leave one angle: the best of a grid, closed in on.
    """

    def misfit(heard: Sequence[SentAndOffered], angles: Array) -> Array:
        """How far the offers of these angles, shape (R, a), are from those that were heard."""
        total = np.zeros(angles.shape)
        c, s = np.cos(angles), np.sin(angles)
        back = np.stack((np.stack((c, s), -1), np.stack((-s, c), -1)), -2)
        for sent, candidates in heard:
            x = turned(back, np.broadcast_to(sent[:, None, :], (*angles.shape, 2)))
            flat = np.ascontiguousarray(x.reshape(-1, 2))
            offers = law.candidates_many(flat, law.indices(flat))[:, 0, 0].reshape(angles.shape)
            total += np.abs(offers - candidates[:, :1, 0])
        return total

    def learn(heard: Sequence[SentAndOffered]) -> Words:
        runs = len(heard[0][0])
        width = 2 * math.pi / ANGLES
        grid = np.broadcast_to(np.arange(ANGLES) * width, (runs, ANGLES))
        found = misfit(heard, grid)
        lowest = (found <= np.roll(found, 1, 1)) & (found <= np.roll(found, -1, 1))
        places = np.where(lowest, found, np.inf).argsort(axis=1)[:, :KEPT]
        best, least = np.zeros(runs), np.full(runs, np.inf)
        for i in range(KEPT):
            angle, step = np.take_along_axis(grid, places[:, i : i + 1], 1), width
            for _ in range(ROUNDS):
                near = angle + np.linspace(-step, step, POINTS)
                near_by = misfit(heard, near)
                at = near_by.argmin(axis=1)[:, None]
                angle, step = np.take_along_axis(near, at, 1), step * 2 / (POINTS - 1)
            value = misfit(heard, angle)[:, 0]
            np.copyto(best, angle[:, 0], where=value < least)
            np.minimum(least, value, out=least)
        words = np.floor((best / (2 * math.pi)) % 1.0 * FULL).astype(np.uint32)
        return words[:, None]

    return learn
