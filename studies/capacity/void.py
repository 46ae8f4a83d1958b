"""The paper's rule allows any number of keys at any alpha above 1, once a key may look at x(k+1).

The rule asks that the defender be certain of the key and that she find every key possible. It does
not ask that the key be a function of the applied input. Take a dense alphabet, and any public
function v of the state that was reached. Call *near* the inputs that lead to x(k+1) with d in D_c:
all of them mean the key v(x(k+1)). Call *band* those that do so with d in D_e only: they take all
other keys in turn. The applied input is near, so every transition agrees, with certainty, on
v(x(k+1)). Every key is possible for her. And whoever computes v has the key: x(k+1) is sent in
clear, so not a bit is secret. See theorem 8 of docs/findings.md.

For one input an alphabet of length sigma + 2 w holds one band whole, w = (alpha - 1) / max(g(b),
g(-b)), and a spacing of w / q puts q - 1 inputs in it.
"""

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protocol.agreement import INSIDE
from protocol.arrays import Array
from protocol.scenario import ConvexSet

ROOM = 1 - 1e-6
"""Of the band's least length, what the spacing counts on: gauges round."""


@dataclass(frozen=True, eq=False)
class VoidKeying:
    """Offsets of one input whose every transition agrees on one of ``keys`` keys, at alpha > 1.

    Parameters
    ----------
    keys : int
        q; as many as one likes.
    alpha : float
        D_e = alpha D_c.
    b : array, shape (n,)
        The column of B.
    H : array, shape (rows, n)
        D_c = { d : H d <= 1 }.
    offsets : array, shape (N,)
        The inputs are v + ``offsets[i]``; a progression about 0.
    """

    keys: int
    alpha: float
    b: Array
    H: Array
    offsets: Array

    @classmethod
    def of(cls, b: ArrayLike, disturbance: ConvexSet, alpha: float, keys: int) -> "VoidKeying":
        """The shortest progression with which every transition agrees.

        The near inputs fill at most sigma, the longest chord of D_c along b. The gauge grows by at
        most max(g(b), g(-b)) an input: next to them, on either side, a length
        w = (alpha - 1) / max(g(b), g(-b)) of inputs is in the band. An alphabet of length
        sigma + 2 w holds one of the two whole, and a spacing of w / q puts the q - 1 other keys
        in it.

        Raises
        ------
        ValueError
            When alpha is not above 1, there are fewer than two keys, or the input moves nothing.
        """
        if not alpha > 1 or keys < 2:
            raise ValueError(
                f"alpha and keys: got {alpha:g} and {keys}, expected above 1 and 2 or more"
            )
        rows, bounds = disturbance.rows()
        H = np.array(rows) / np.array(bounds)[:, None]
        column = np.asarray(b, dtype=float)
        up, down = float((H @ column).max()), float((-H @ column).max())
        if not min(up, down) > 0:
            raise ValueError("plant.B: the input moves no state, expected one that does")
        band = (alpha - 1) / max(up, down)
        widest = _widest(H, column)
        spacing = ROOM * band / keys
        half = math.ceil((widest / 2 + band) / spacing)
        offsets: Array = np.arange(-half, half + 1, dtype=float) * spacing
        return cls(keys, alpha, column, H, offsets)

    def gauges(self, applied: float, d: Array) -> Array:
        """Gauges of D_c at x(k+1) for every offered input, shape (N,)."""
        push = (applied - self.offsets)[:, None] * self.b + d
        out: Array = np.maximum(0.0, (push @ self.H.T).max(axis=1))
        return out

    def labels(self, gauges: Array, x_next: Array) -> NDArray[np.int64]:
        """The key that each offered input means, -1 beyond D_e; all of it is public."""
        v = public_key(x_next, self.keys)
        out = np.full(len(gauges), -1, dtype=np.int64)
        band = np.flatnonzero((gauges > INSIDE) & (gauges <= self.alpha))
        out[band] = (v + 1 + np.arange(len(band)) % (self.keys - 1)) % self.keys
        out[gauges <= INSIDE] = v
        return out


def public_key(x_next: Array, keys: int) -> int:
    """v: a key that anyone computes from the state that was sent in clear."""
    digest = hashlib.blake2b(np.asarray(x_next, dtype="<f8").tobytes(), digest_size=8).digest()
    return int.from_bytes(digest, "big") % keys


def _widest(H: Array, b: Array) -> float:
    """The longest stretch of inputs that D_c holds along b, its longest chord in that direction."""
    from scipy.optimize import linprog

    n = len(b)
    # d and d + t b both in D_c, t as large as may be
    rows = np.vstack([np.hstack([H, np.zeros((len(H), 1))]), np.hstack([H, (H @ b)[:, None]])])
    cost = np.zeros(n + 1)
    cost[-1] = -1.0
    found = linprog(cost, A_ub=rows, b_ub=np.ones(len(rows)), bounds=[(None, None)] * (n + 1))
    assert found.x is not None, "D_c is compact, with the origin inside"
    return float(found.x[-1])
