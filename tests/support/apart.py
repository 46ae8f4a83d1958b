"""How far candidates lie from one another, for both sides."""

import numpy as np

from controller_service.sets.separation import Separation
from protocol.arrays import Array


def distances(sep: Separation, points: Array) -> tuple[Array, Array]:
    """Both norms of the difference of every two points, shape (points, m)."""
    v = (points[:, None] - points[None])[~np.eye(len(points), dtype=bool)]
    return np.abs(v @ sep.apart.T).max(axis=-1), np.abs(v @ sep.together.T).max(axis=-1)
