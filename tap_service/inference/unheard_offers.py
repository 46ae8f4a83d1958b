"""What was applied, by the readings of the state alone: no offer was heard.

Where all candidates share one input the move x(k+1) - A x(k) is B v(x) + B o_b + d. The offsets are
of a known shape: a progression for one input; for two a grid, whose steps are those of a
parallelogram that two coordinates of D_e make. Their scale is that of D_c, which nobody tells. v is
what the policy's cost asks for almost everywhere, or some affine function that is fitted beside the
labels. So a move is drawn from a mixture of M parts of equal weights, or v does not explain it: the
likeliest shape and scale leave little, and let the labels fall evenly. Where v bends, the
neighbours of a state tell it better than all states together.

Where the candidates have a cost each they follow from the state, as far as the policy says, but for
the width of D_c; the true one is that under which the nearest candidate leaves the least. The
message stays unread either way: no cipher symbol was heard.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from protocol.arrays import Array
from protocol.convex import SetError, planar_reduce
from tap_service.capture.transcript import Transition
from tap_service.inference.law import KnownLaw, PlanarLaw
from tap_service.inference.verdicts import Inferred, InferredStep, thresholds_above

TINY: Final = 1e-12

ENOUGH: Final = 24
"""Moves from which a law is fitted."""

SCALES: Final = tuple(np.geomspace(1 / 64, 1.0, 86).tolist())
"""Of D_c, over D_e: five in a hundred apart."""

BEST: Final = 6
"""Shapes and scales that are followed further, of each way to begin."""

ROUNDS: Final = 12
"""Labels and fits in turn."""

NEARBY: Final = 0.02
"""Over D_c: how far v is off where the policy gives it."""

FINER: Final = 41
"""Widths about the best one that are then tried."""

STRAY: Final = 0.1
"""Share of the moves that v may not explain at first."""

NEAR: Final = 20
"""Neighbours that tell v where it bends."""

BENDS: Final = 6
"""Rounds in which labels go from where v is known to where it bends."""

SLOPES: Final = 1.0
"""How strongly the slopes of v as a whole are kept there."""

SAMPLES: Final = 64
"""Draws that stand for a step's probabilities."""

NEARLY: Final = 1.06
"""Ratio within which the width is then known."""

WIDTHS: Final = tuple(np.geomspace(1 / 64, 1.0, 209).tolist())
"""Widths of D_c over D_e that are tried where the candidates have a cost each."""

BULK: Final = 0.95
"""Share of the steps whose disturbance counts then: some states lie outside the terminal set."""


def unit_offsets(B: Array, edge: Array, size: int) -> Iterator[Array]:
    """The alphabets that there may be, centred, for D_c as large as D_e; shape (M, m) each.

    Parameters
    ----------
    B : array, shape (n, m)
    edge : array, shape (n,)
        How far D_e reaches in each coordinate.
    size : int
        M.
    """
    rows = B / (2 * edge)[:, None]
    if rows.shape[1] == 1:
        yield (np.arange(size) - (size - 1) / 2)[:, None] / np.abs(rows).max()
        return
    if rows.shape[1] != 2:
        return
    both = np.vstack([rows, -rows])
    lengths = np.linalg.norm(both, axis=1)
    moves = lengths > 1e-12 * lengths.max()
    try:
        hull = planar_reduce(both[moves] / lengths[moves, None], 1 / lengths[moves])
    except SetError:
        return
    rows = (hull.H / hull.h[:, None])[: len(hull.h) // 2]
    for pair in combinations(range(len(rows)), 2):
        steps = np.linalg.inv(rows[list(pair)]).T
        for a in range(1, size + 1):
            if size % a == 0:
                i, j = np.meshgrid(np.arange(a), np.arange(size // a), indexing="ij")
                points = np.stack([i.ravel(), j.ravel()], axis=1) @ steps
                yield points - 0.5 * (points.min(axis=0) + points.max(axis=0))


@dataclass(frozen=True)
class Fit:
    """How the moves are explained.

    Parameters
    ----------
    v : array, shape (K, m)
    unit : array, shape (M, m)
        Offsets for D_c as large as D_e.
    scale : float
        D_c over D_e.
    reach : array, shape (n,)
        How far the disturbance reaches in each coordinate.
    blur : array, shape (n,)
        Deviation of B v, as far as v is not known.
    stray : float
        Share of the moves that v does not explain.
    shares : array, shape (K, M)
        Probability of each symbol; they sum to that of a move that is explained.
    likelihood : float
    """

    v: Array
    unit: Array
    scale: float
    reach: Array
    blur: Array
    stray: float
    shares: Array
    likelihood: float = -np.inf

    @property
    def explained(self) -> Array:
        """Probability that v explains a move, shape (K, 1); never quite 0."""
        found: Array = np.maximum(self.shares.sum(axis=1, keepdims=True), TINY)
        return found

    @property
    def offset(self) -> Array:
        """The offset expected of each move, shape (K, m)."""
        return self.scale * (self.shares @ self.unit) / self.explained


class Moves:
    """The moves between states that were read.

    Parameters
    ----------
    A, B : array
        Her model.
    edge : array, shape (n,)
        How far D_e reaches in each coordinate.
    x, after : array, shape (K, n)
    noise : float
        Standard deviation of what she reads.
    """

    def __init__(
        self, A: Array, B: Array, edge: Array, x: Array, after: Array, noise: float
    ) -> None:
        self._B, self._edge = B, edge
        self._noise = noise * np.sqrt(1 + (A**2).sum(axis=1))
        self._moved = after - x @ A.T
        self._input = self._moved @ (np.linalg.pinv(B / edge[:, None]) / edge).T
        self._at = (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), TINY)
        self._affine = np.hstack([np.ones((len(x), 1)), self._at])
        # a stray is anywhere where moves were seen
        self._anywhere = -float(np.log(np.ptp(self._moved, axis=0) + 2 * edge).sum())

    def likeliest(
        self, free: Array, units: Sequence[Array], clipped: Callable[[float], Array] | None = None
    ) -> Fit | None:
        """The likeliest fit with offsets of one of these shapes.

        ``free`` is v by the policy, and ``clipped`` the same by the width of D_c, where the policy
        says what clips it.
        """
        fitted = self._affine @ np.linalg.lstsq(self._affine, self._input, rcond=None)[0]
        nothing = np.zeros((len(free), 0))

        def begun(unit: Array, v: Array, scale: float, off: float) -> Fit:
            width = scale * self._edge
            return self._labelled(Fit(v, unit, scale, 0.9 * width, off * width, STRAY, nothing))

        ways = ((free, NEARBY), (fitted, 0.1))
        tried: list[Fit] = []
        for v, off in ways:
            mine = [begun(unit, v, s, off) for unit in units for s in SCALES]
            mine.sort(key=lambda fit: -fit.likelihood)
            tried += mine[:1] + [self._followed(fit) for fit in mine[:BEST]]
        if clipped is not None:
            mine = [begun(unit, clipped(s), s, NEARBY) for unit in units for s in SCALES]
            best = max(mine, key=lambda fit: fit.likelihood)
            near = (best.scale * np.geomspace(1 / NEARLY, NEARLY, FINER)).tolist()
            fine = [begun(best.unit, clipped(s), s, NEARBY) for s in near if s <= 1.0]
            tried += [self._labelled(self._measured(fit)) for fit in (best, *fine)]
        return max(tried, key=lambda fit: fit.likelihood, default=None)

    def _followed(self, fit: Fit) -> Fit:
        """Labels and fits in turn."""
        for _ in range(ROUNDS):
            fit = self._labelled(self._refitted(self._measured(fit)))
        return fit

    def _densities(self, fit: Fit, v: Array, blur: Array) -> Array:
        """Log density of each move under each symbol, shape (K, M), where ``v`` is offered."""
        from scipy.special import log_ndtr, ndtr

        left = (self._moved - v @ self._B.T)[:, None] - fit.scale * fit.unit @ self._B.T
        blur = np.broadcast_to(np.hypot(blur, self._noise), self._moved.shape)
        log = np.full(left.shape[:2], -np.log(len(fit.unit)))
        for c, reach in enumerate(fit.reach):
            off, wide = np.abs(left[:, :, c]), blur[:, c, None]
            inside = ndtr((reach - off) / wide) - ndtr((-reach - off) / wide)
            beyond = log_ndtr(np.minimum((reach - off) / wide, 0.0))
            log += np.where(inside > TINY, np.log(np.maximum(inside, TINY)), beyond)
            log -= np.log(2 * reach)
        return log

    def _labelled(self, fit: Fit) -> Fit:
        """The symbols' probabilities by v, offsets and the disturbance's reach."""
        log = self._densities(fit, fit.v, fit.blur) + np.log(1 - fit.stray)
        stray = np.log(fit.stray) + self._anywhere
        total = np.logaddexp(np.logaddexp.reduce(log, axis=1), stray)
        shares = np.exp(log - total[:, None])
        return replace(fit, shares=shares, likelihood=float(total.sum()))

    def _measured(self, fit: Fit) -> Fit:
        """The disturbance's reach and the share of strays, by the labels so far."""
        left = (self._moved - fit.v @ self._B.T)[:, None] - fit.scale * fit.unit @ self._B.T
        variance = np.einsum("kb,kbc->c", fit.shares, left**2) / max(fit.shares.sum(), TINY)
        variance = np.maximum(variance - self._noise**2, (0.1 * fit.scale * self._edge) ** 2)
        reach = np.minimum(np.sqrt(3 * variance), fit.scale * self._edge)
        stray = float(np.clip(1 - fit.shares.sum() / len(fit.v), 0.002, 0.5))
        return replace(fit, reach=reach, stray=stray)

    def _refitted(self, fit: Fit) -> Fit:
        """v as an affine function, and the scale, by the labels so far."""
        root = np.sqrt(fit.explained)
        target = root * (self._input - fit.offset)
        v = self._affine @ np.linalg.lstsq(root * self._affine, target, rcond=None)[0]
        along = float((fit.shares @ fit.unit * (self._input - v)).sum())
        scale = along / max(float((fit.shares @ fit.unit**2).sum()), TINY)
        scale = float(np.clip(scale, 0.9 * fit.scale, 1.1 * fit.scale))
        known = self._affine.shape[1] / max(float(fit.shares.sum()), 1.0)
        return replace(fit, v=v, scale=scale, blur=fit.reach * np.sqrt(known / 3))

    def bent(self, fit: Fit) -> Array:
        """The symbols' probabilities, where v is by its neighbours what it is not as a whole."""
        from scipy.spatial import cKDTree

        found = cKDTree(self._at).query(self._at, min(NEAR, len(self._at) - 1) + 1)
        far, near = (np.asarray(one)[:, 1:] for one in found)
        close = 1.05 - (far / np.maximum(far[:, -1:], TINY)) ** 2
        phi = np.insert(self._at[near] - self._at[:, None], 0, 1.0, axis=2)
        ridge = np.diag([TINY, *[SLOPES] * self._at.shape[1]])
        whole = self._densities(fit, fit.v, fit.blur) + np.log(1 - fit.stray)
        stray = np.log(STRAY * fit.stray) + self._anywhere
        for _ in range(BENDS):
            left = self._input - fit.offset - fit.v
            weight = (1e-3 + fit.explained[:, 0] ** 2)[near] * close
            gram = np.einsum("ka,kai,kaj->kij", weight, phi, phi) + ridge
            theta = np.linalg.solve(gram, np.einsum("ka,kai,kam->kim", weight, phi, left[near]))
            off = left[near] - np.einsum("kai,kim->kam", phi, theta)
            spread = np.einsum("ka,kam->km", weight, off**2) / weight.sum(axis=1)[:, None]
            blur = np.maximum(np.sqrt(spread @ self._B.T**2 / 3), 0.1 * fit.scale * self._edge)
            bent = self._densities(fit, fit.v + theta[:, 0], blur) + np.log(fit.stray)
            both = np.logaddexp(whole, bent)
            total = np.logaddexp(np.logaddexp.reduce(both, axis=1), stray)
            fit = replace(fit, shares=np.exp(both - total[:, None]))
        return fit.shares


def infer_from_readings(
    A: Array,
    B: Array,
    shape: Array,
    law: KnownLaw,
    size: int,
    noise: float,
    transitions: Sequence[Transition],
    planar: PlanarLaw | None = None,
) -> Inferred:
    """Transitions of which no offer was heard, and the thresholds that remain.

    Parameters
    ----------
    A, B : array
        Her model.
    shape : array, shape (rows, n)
        H / h of D_e: the gauge of v is the largest entry of ``shape @ v``.
    law : KnownLaw
    size : int
        M.
    noise : float
        Standard deviation of what she reads.
    planar : PlanarLaw, optional
        With its bounds, where the policy gives them.
    """
    samples: list[Array | None] = [None] * len(transitions)
    among = (0.0, 1.0)
    at = [i for i, t in enumerate(transitions) if t.x is not None and t.x_next is not None]
    if len(at) >= (ENOUGH if law.shared else 1):
        x = np.array([transitions[i].x for i in at])
        after = np.array([transitions[i].x_next for i in at])
        if law.shared:
            edge = 1 / np.abs(shape).max(axis=0)
            moves = Moves(A, B, edge, x, after, noise)
            clipped = _clipped(planar, x) if planar is not None and planar.gap else None
            units = list(unit_offsets(B, edge, size))
            fit = moves.likeliest(x @ law.free[0].T, units, clipped)
            drawn = [] if fit is None else [_draws(row) for row in moves.bent(fit)]
        else:
            gauges, among = _by_costs(after - x @ A.T, B, shape, law, x, planar)
            drawn = [row[None] for row in gauges]
        for i, draws in zip(at, drawn, strict=False):
            samples[i] = draws
    return Inferred([InferredStep(t, s) for t, s in zip(transitions, samples, strict=True)], among)


def _clipped(planar: PlanarLaw, x: Array) -> Callable[[float], Array]:
    """v in states ``x`` by the width of D_c."""
    return lambda width: planar.of_width(width).answers(x)


def _draws(share: Array) -> Array:
    """Gauges of which the least are as often each symbol's as its probability says."""
    edges = np.cumsum(share + (1 - share.sum()) / len(share))
    choice = np.searchsorted(edges, (np.arange(SAMPLES) + 0.5) / SAMPLES * edges[-1])
    found: Array = 1.0 - np.eye(len(share))[choice]
    return found


def _by_costs(
    moved: Array, B: Array, shape: Array, law: KnownLaw, x: Array, planar: PlanarLaw | None
) -> tuple[Array, tuple[float, float]]:
    """Gauges of the candidates that the policy's costs ask for, shape (K, M), and thresholds."""
    free: Array = np.einsum("imn,sn->sim", law.free, x)

    def gauges(width: float) -> Array:
        offers = free if planar is None else planar.of_width(width).offers(x)[:, :, None]
        residual = moved[:, None] - offers @ B.T
        found: Array = np.maximum((residual @ shape.T).max(axis=2), 0.0)
        return found

    def left(width: float) -> float:
        return float(np.quantile(gauges(width).min(axis=1), BULK))

    if planar is not None:
        width = min(WIDTHS, key=left)
        return gauges(width), (width / NEARLY, min(width * NEARLY, 1.0))
    return gauges(1.0), thresholds_above(left(1.0))
