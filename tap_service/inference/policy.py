"""The control law as someone who was told the policy can use it: what offers say of the state.

Each candidate minimises a quadratic cost under constraints. Where none is active it is a linear
function of the state, u_i = F_i x. Where one is, it lies on a facet of the target set, and the
line A x + B u meets that facet. The sets depend on D_c, which she does not know; but the terminal
set T_0 that the paper's synthesis gives is the sum of the images of D_c under A + B K, and scales
with D_c. So, with the policy's gain K and the shape of D_e, its facets are known up to one number.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from protocol.arrays import Array
from protocol.knowledge import Knowledge

TINY: Final = 1e-9

MOST_TERMS: Final = 200
"""Images of the disturbance summed at most; with more, A + B K hardly contracts."""

LEFT: Final = 1e-3
"""Share of the disturbance within which the image after the last one summed must lie."""

PARALLEL: Final = 1e-9
"""A facet whose normal meets B by less than this share bounds no input."""


@dataclass(frozen=True)
class KnownLaw:
    """The law, as far as the policy says it.

    Parameters
    ----------
    free : array, shape (M, m, n)
        F_i: the candidates where no constraint is active.
    shared : bool
        Whether one cost makes v and the candidates stand about it at fixed offsets, which the first
        offer shows; ``free`` is then that cost's alone.
    """

    free: Array
    shared: bool = False

    @classmethod
    def of(cls, knowledge: Knowledge) -> "KnownLaw | None":
        """What the policy and the model in ``knowledge`` give; None without a usable policy."""
        k = knowledge
        if k.policy is None or k.A is None or k.B is None:
            return None
        shared = len(k.policy.costs) == 1
        if not shared and len(k.policy.costs) != k.candidates:
            return None
        A, B = np.array(k.A), np.array(k.B)
        free = []
        for cost in k.policy.costs:
            weighted = B.T * np.array(cost.next_state)
            P = weighted @ B + np.diag(cost.input)
            if not np.linalg.cond(P) < 1e12:
                return None
            free.append(-np.linalg.solve(P, weighted @ A))
        return cls(np.array(free), shared)


def terminal_facets(
    A: Array, B: Array, K: Array, V: Array, H: Array, h: Array
) -> tuple[Array, Array] | None:
    """Facets of T_0 ~ D for a planar plant with one input, as bounds of u.

    T_0 is the outer approximation of Rakovic et al. (2005), (1 - s)^-1 times the sum of the images
    of D = { d : H d <= h } under the powers of A + B K.

    Parameters
    ----------
    A, B, K : array
    V : array, shape (corners, 2)
        Corners of D.
    H, h : array

    Returns
    -------
    tuple of array or None
        u <= slope x + offset, then u >= slope x + offset, a row (slope, offset) each, shape (J, 3);
        None where A + B K hardly contracts.
    """
    closed = A + B @ K
    powers = [np.eye(2)]
    while True:
        image = closed @ powers[-1]
        left = float(((V @ image.T @ H.T) / h).max())
        if left <= LEFT:
            break
        if len(powers) == MOST_TERMS:
            return None
        powers.append(image)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    normals: Array = np.concatenate([H @ turn @ p.T for p in powers]) @ turn.T
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0] / lengths[lengths > 0, None]
    normals = np.unique(np.vstack([normals, -normals]).round(12), axis=0)
    support = sum((V @ p.T @ normals.T).max(axis=0) for p in powers) / (1 - left)
    offsets = support - (V @ normals.T).max(axis=0)
    across = normals @ B[:, 0]
    out = []
    for side in (1, -1):
        bounding = side * across > PARALLEL * float(np.linalg.norm(B))
        by = across[bounding, None]
        out.append(np.hstack([-(normals[bounding] @ A) / by, offsets[bounding, None] / by]))
    return out[0], out[1]


def corners_of(H: Array, h: Array) -> Array:
    """Corners of a planar polytope, from every pair of its rows."""
    out = []
    for i in range(len(H)):
        for j in range(i):
            pair = H[[i, j]]
            if abs(np.linalg.det(pair)) > 1e-12:
                v = np.linalg.solve(pair, h[[i, j]])
                if (v @ H.T <= h * (1 + 1e-9)).all():
                    out.append(v)
    return np.array(out)
