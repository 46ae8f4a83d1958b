"""The control law, learned from the transcript by someone who knows that there is one.

Offer(k) is a function of x(k), affine in pieces: each of its inputs is an affine function of the
state in every region of a partition that she does not know. Close neighbours share a region, so
that an affine fit through a few of them either holds exactly for many other pairs, and is a piece
of the law, or for none (:class:`LawPieces`). Where noise hides that, neighbours are averaged
(:class:`LawNearby`). Either way an offer says something of a state that was not heard, and a state
of an offer.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array

EXACT: Final = 1e-6
"""Residual, over the spread of the input, up to which a pair lies on a piece."""

SUPPORT: Final = 6
"""Pairs beyond those it was drawn through that a piece must explain."""

PIECES: Final = 24
"""Pieces looked for in one input."""

TRIES: Final = 120
"""Affine fits tried for one input."""

CLOSE: Final = 7
"""Nearest pairs that say which pieces are likely around a state."""

RARE: Final = 0.1
"""Pairs that a combination of pieces counts for where it was not seen close by."""

UNKNOWN: Final = -1
"""In place of a piece where none explains the value."""

READING_NOISE: Final = 1e-5
"""Standard deviation given to a reading on exact pieces, so that its algebra stays regular."""

NEIGHBOURS: Final = 12
"""Pairs that are averaged where pieces cannot be found."""

TINY: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Reading:
    """What an offer says of its state: C x = y with covariance R, on a combination of pieces."""

    C: Array
    y: Array
    R: Array
    combination: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Form:
    """What a state says of its offer: u = G x + g with covariance R.

    ``G`` has shape (M, m, n), ``g`` (M, m); ``R`` (M m, M m); ``weight`` is a log prior.
    """

    weight: float
    G: Array
    g: Array
    R: Array

    def at(self, x: Array) -> Array:
        """The offers in states ``x``, shape (S, n); returns shape (S, M, m)."""
        out: Array = np.einsum("imn,sn->sim", self.G, x) + self.g
        return out


class LearnedLaw(Protocol):
    """The law as far as it was learned."""

    def readings(self, offer: Array) -> list[Reading]:
        """What ``offer``, shape (M, m), says of its state: one reading or several rival ones."""

    def prior(self, reading: Reading, x: Array) -> float:
        """Log probability of the reading's pieces around state ``x``."""

    def forms(self, x: Array) -> list[Form]:
        """What the offer may be around state ``x``."""


def heard_exactly(offer: Array, n: int) -> Form:
    """The form of an offer that was heard."""
    size, m = offer.shape
    return Form(0.0, np.zeros((size, m, n)), offer, np.zeros((size * m, size * m)))


class LawPieces:
    """Exact pieces of the law, and which of them go together.

    Parameters
    ----------
    x : array, shape (N, n)
    u : array, shape (N, M, m)

    Attributes
    ----------
    pieces : list of array, shapes (P, n + 1)
        Of each input: slope and offset of each piece.
    """

    def __init__(self, x: Array, u: Array) -> None:
        self._x = x
        self._shape = u.shape[1:]
        flat = u.reshape(len(u), -1)
        self._scale = np.maximum(x.std(axis=0), TINY)
        self.pieces: list[Array] = []
        labels = []
        for values in flat.T:
            pieces, label = self._find(values, EXACT * max(float(values.std()), TINY))
            self.pieces.append(pieces)
            labels.append(label)
        self._labels = np.stack(labels, axis=1)
        self._combinations = Counter(tuple(row) for row in self._labels.tolist())

    @property
    def explained(self) -> float:
        """Share of the pairs that the pieces explain."""
        return float((self._labels != UNKNOWN).all(axis=1).mean())

    def _find(self, values: Array, tolerance: float) -> tuple[Array, NDArray[np.intp]]:
        count, n = self._x.shape
        left = np.hstack([self._x, np.ones((count, 1))])
        label = np.full(count, UNKNOWN, dtype=np.intp)
        pieces: list[Array] = []
        rng = np.random.default_rng(0)
        for _ in range(TRIES):
            left_over = np.flatnonzero(label == UNKNOWN)
            if len(left_over) < SUPPORT + n + 1 or len(pieces) == PIECES:
                break
            seed = rng.choice(left_over)
            distance = (((self._x[left_over] - self._x[seed]) / self._scale) ** 2).sum(axis=1)
            near = left_over[np.argsort(distance)[: n + 3]]
            chosen = rng.choice(near, n + 1, replace=False)
            try:
                piece = np.linalg.solve(left[chosen], values[chosen])
            except np.linalg.LinAlgError:
                continue
            on = np.abs(values - left @ piece) < tolerance
            if (on & (label == UNKNOWN)).sum() < n + 1 + SUPPORT:
                continue
            piece = np.linalg.lstsq(left[on], values[on], rcond=None)[0]
            on = np.abs(values - left @ piece) < tolerance
            label[on & (label == UNKNOWN)] = len(pieces)
            pieces.append(piece)
        return np.array(pieces).reshape(-1, n + 1), label

    def readings(self, offer: Array) -> list[Reading]:
        """One for every combination of pieces that occurred."""
        u = offer.ravel()
        n = self._x.shape[1]
        out = []
        for combination in self._combinations:
            known = [(q, p) for q, p in enumerate(combination) if p != UNKNOWN]
            C = np.array([self.pieces[q][p][:n] for q, p in known]).reshape(-1, n)
            y = np.array([u[q] - self.pieces[q][p][n] for q, p in known])
            R = READING_NOISE**2 * np.eye(len(known))
            out.append(Reading(C, y, R, combination))
        return out

    def prior(self, reading: Reading, x: Array) -> float:
        """By the pieces of the nearest pairs; every piece keeps a small chance."""
        times = self._around(x)[reading.combination]
        return float(np.log((times + RARE) / (CLOSE + RARE * len(self._combinations))))

    def _around(self, x: Array) -> Counter[tuple[int, ...]]:
        distance = (((self._x - x) / self._scale) ** 2).sum(axis=1)
        near = np.argpartition(distance, CLOSE)[:CLOSE]
        return Counter(tuple(row) for row in self._labels[near].tolist())

    def forms(self, x: Array) -> list[Form]:
        """One for every combination of pieces among the nearest pairs."""
        size, m = self._shape
        n = self._x.shape[1]
        out = []
        for combination, times in self._around(x).items():
            if UNKNOWN in combination:
                continue
            rows = np.array([self.pieces[q][p] for q, p in enumerate(combination)])
            G, g = rows[:, :n].reshape(size, m, n), rows[:, n].reshape(size, m)
            out.append(Form(float(np.log(times / CLOSE)), G, g, np.zeros((size * m, size * m))))
        return out


class LawNearby:
    """The law by local averages, for one who hears with noise.

    Parameters
    ----------
    x : array, shape (N, n)
    u : array, shape (N, M, m)
    noise : float
        Standard deviation of what she reads.
    """

    def __init__(self, x: Array, u: Array, noise: float) -> None:
        self._x, self._u = x, u.reshape(len(u), -1)
        self._shape = u.shape[1:]
        self._noise = noise
        self._x_scale = np.maximum(x.std(axis=0), TINY)
        self._u_scale = np.maximum(self._u.std(axis=0), TINY)

    def readings(self, offer: Array) -> list[Reading]:
        """One: the state of the nearest offers."""
        mean, R = self._fit(self._u, self._u_scale, self._x, offer.ravel())
        return [Reading(np.eye(len(mean)), mean, R)]

    def prior(self, reading: Reading, x: Array) -> float:
        """Nothing: there is one reading only."""
        del reading, x
        return 0.0

    def forms(self, x: Array) -> list[Form]:
        """One: the offer of the nearest states."""
        size, m = self._shape
        mean, R = self._fit(self._x, self._x_scale, self._u, x)
        return [Form(0.0, np.zeros((size, m, len(x))), mean.reshape(size, m), R)]

    def _fit(self, inputs: Array, scale: Array, outputs: Array, at: Array) -> tuple[Array, Array]:
        distance = np.square((inputs - at) / scale).sum(axis=1)
        near = np.argpartition(distance, NEIGHBOURS)[:NEIGHBOURS]
        left = np.hstack([(inputs[near] - at) / scale, np.ones((NEIGHBOURS, 1))])
        gram = left.T @ left + 1e-8 * np.eye(left.shape[1])
        theta = np.linalg.solve(gram, left.T @ outputs[near])
        residual = outputs[near] - left @ theta
        spread = residual.T @ residual / max(NEIGHBOURS - left.shape[1], 1)
        # how far the point lies from its neighbours counts as well
        leverage = 1.0 + float(np.linalg.inv(gram)[-1, -1])
        return theta[-1], spread * leverage + (self._noise**2 + TINY) * np.eye(outputs.shape[1])


def learn_law(x: Array, u: Array, noise: float) -> LearnedLaw | None:
    """The law from the pairs heard: by pieces where they are exact, nearby otherwise."""
    if len(x) < 2 * NEIGHBOURS:
        return None
    if noise == 0:
        pieces = LawPieces(x, u)
        if pieces.explained > 0.5:
            return pieces
    return LawNearby(x, u, noise)
