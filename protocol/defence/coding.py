"""`coding`: the measurement goes out turned by a fresh orthogonal matrix of the key, x -> S(k) x.

Who rewrites messages must turn her correction e likewise. Turned by another matrix T it leaves
e - S^T T e in what the controller reads, as long as 2 sin(phi / 2) abs(e) for an angle phi between
them. So a correction within D_c goes unseen, and so does any that is made before the plant's end
turns the reading. One matrix for all steps is learnt from two of them.
"""

import math
from typing import ClassVar, Final

import numpy as np

from protocol.arrays import Array, Integers
from protocol.defence.base import Defence, Opened, Wire, Words

FULL: Final = 2.0**32


def words_of(n: int) -> int:
    """Words of key for a matrix: one for a sign or an angle, else n + (n - 1) + ... + 2 and a sign.

    Five states take 15 words, 480 bits.
    """
    return 1 if n <= 2 else n * (n + 1) // 2


def matrices(words: Integers, n: int) -> Array:
    """Orthogonal matrices from uniform words, shape (..., words_of(n)) to (..., n, n).

    One state: a sign, of the top bit. Two: the rotation by 2 pi w / 2^32. More: a product of
    Householder reflections of normal vectors, which is uniform over all orthogonal matrices
    (Stewart, SIAM J. Numer. Anal. 17, 1980), to the 32 bits of a word.

    Raises
    ------
    ValueError
        When the words are not as many as n needs.
    """
    if words.shape[-1:] != (words_of(n),):
        raise ValueError(f"coding: got {words.shape[-1]} words, expected {words_of(n)} for n = {n}")
    uniform = (words.astype(np.float64) + 0.5) / FULL
    if n == 1:
        return np.where(uniform < 0.5, 1.0, -1.0)[..., None]
    if n == 2:
        angle = 2 * math.pi * uniform[..., 0]
        c, s = np.cos(angle), np.sin(angle)
        return np.stack((np.stack((c, -s), -1), np.stack((s, c), -1)), -2)
    from scipy.special import ndtri

    out = np.broadcast_to(np.eye(n), (*words.shape[:-1], n, n)).copy()
    out[..., n - 1, n - 1] = np.where(uniform[..., -1] < 0.5, 1.0, -1.0)
    at = 0
    for size in range(2, n + 1):
        v = ndtri(uniform[..., at : at + size])
        at += size
        v /= np.linalg.norm(v, axis=-1, keepdims=True)
        # H e_1 = v up to sign, for a reflection in the lower ``size`` coordinates
        sign = np.where(v[..., :1] >= 0, 1.0, -1.0)
        w = v.copy()
        w[..., :1] += sign
        w /= np.linalg.norm(w, axis=-1, keepdims=True)
        lower = out[..., n - size :, :]
        lower -= 2 * w[..., :, None] * (w[..., None, :] @ lower)
        lower *= -sign[..., None]
    return out


def turned(S: Array, x: Array) -> Array:
    """S x, shapes (..., n, n) and (..., n)."""
    out: Array = (S @ x[..., None])[..., 0]
    return out


class Coding(Defence):
    """Turns each measurement by a matrix of its own."""

    name: ClassVar[str] = "coding"
    codes: ClassVar[bool] = True

    def __init__(self, states: int, candidates: int) -> None:
        super().__init__(states, candidates)
        self.step_words = words_of(states)

    def encode(self, k: int, session: Words, step: Integers, x: Array) -> Wire:  # noqa: ARG002
        """S x."""
        return Wire(turned(matrices(step, self.states), x))

    def decode(self, k: int, session: Words, step: Integers, wire: Wire) -> Opened:  # noqa: ARG002
        """S' of what came; nothing is tested here."""
        back = np.swapaxes(matrices(step, self.states), -1, -2)
        return Opened(turned(back, wire.values), np.zeros(wire.values.shape[:-1], bool))


class StaticCoding(Coding):
    """One matrix for the whole session: what two steps give away."""

    name: ClassVar[str] = "static-coding"

    def __init__(self, states: int, candidates: int) -> None:
        super().__init__(states, candidates)
        self.session_words, self.step_words = self.step_words, 0

    def encode(self, k: int, session: Words, step: Integers, x: Array) -> Wire:  # noqa: ARG002
        """S x."""
        return super().encode(k, session, session, x)

    def decode(self, k: int, session: Words, step: Integers, wire: Wire) -> Opened:  # noqa: ARG002
        """S' of what came."""
        return super().decode(k, session, session, wire)
