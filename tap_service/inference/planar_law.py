"""The law of a planar plant with one input, to the last digit: free parts, and what clips them.

Every program answers u = clip(F x, low(x), high(x)), where the bounds are the facets of the set
that the next state must be in. They are computed from the policy, up to the width of D_c.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from protocol.arrays import Array, Flags, Indices
from protocol.knowledge import Knowledge
from tap_service.inference.affine_law import ANYTHING, ASTRAY, Form, Item
from tap_service.inference.policy import KnownLaw, corners_of, terminal_facets

CLIPPED: Final = 1e-7
"""Over the spread of the inputs: beyond this from its free part an input was clipped."""

MOST_PAIRS: Final = 500
"""Blurred pairs by which a width is looked for."""

STATES: Final = 64
"""States drawn about each that was heard blurred."""

EXACT: Final = 1e-6
"""Standard deviation of an answer that was read exactly, over the spread of the answers."""

SLACK: Final = 1e-3
"""By how much an answer may be off, over their spread."""

UNEXPLAINED: Final = -30.0
"""Log likelihood of an offer that a width does not explain."""


@dataclass(frozen=True)
class PlanarLaw:
    """What is offered in which state.

    Parameters
    ----------
    free : array, shape (V, 2)
        F of each program.
    high, low : array, shapes (J, 3) and (L, 3)
        Facets: u <= (>=) slope x + offset, the offset for D_c as large as D_e.
    gap : float
        Distance of neighbouring candidates, for D_c as large as D_e, where they stand at fixed
        offsets about one program's answer; 0 where each program makes one.
    width : float
        D_c over D_e.
    size : int
        M.
    spread : float
        Standard deviation of the answers.
    doubt : float
        By how much an answer may be off, where the width is known so well only.
    """

    free: Array
    high: Array
    low: Array
    gap: float
    size: int
    width: float = 1.0
    spread: float = 1.0
    doubt: float = 0.0

    @classmethod
    def of(cls, knowledge: Knowledge) -> "PlanarLaw | None":
        """The law that the policy gives, or None where it does not tell its facets."""
        k, known = knowledge, KnownLaw.of(knowledge)
        if known is None or k.policy is None:
            return None
        if k.policy.together and k.policy.gain is not None:
            return None  # the candidates coincide in T_0
        if k.disturbance_H is None or k.disturbance_h is None or known.free.shape[1:] != (1, 2):
            return None
        A, B = np.array(k.A), np.array(k.B)
        H, h = np.array(k.disturbance_H), np.array(k.disturbance_h)
        V = corners_of(H, h)
        if len(V) < 3:
            return None
        gap = 0.0
        if known.shared:
            if k.policy.spacing is None:
                return None
            gap = k.policy.spacing / float(((H / h[:, None]) @ B[:, 0]).max())
            ends = 0.5 * gap * (k.candidates - 1) * B[:, 0]
            V = np.vstack([V + ends, V - ends])
            across = np.array([[-B[1, 0], B[0, 0]]])
            H = np.vstack([H, across, -across])
            h = (V @ H.T).max(axis=0)
        K = _gain(k, A, B)
        facets = None if K is None else terminal_facets(A, B, K, V, H, h)
        return None if facets is None else cls(known.free[:, 0], *facets, gap, k.candidates)

    @property
    def programs(self) -> int:
        """V, the programs solved for an offer."""
        return len(self.free)

    def of_width(self, width: float) -> "PlanarLaw":
        """The same for another width of D_c."""
        return replace(self, width=width)

    def answers(self, x: Array) -> Array:
        """The programs' answers in states ``x``, shape (S, 2); returns shape (S, V)."""
        u: Array = np.minimum(x @ self.free.T, self._most(x)[:, None])
        return np.maximum(u, self._least(x)[:, None])

    def _most(self, x: Array) -> Array:
        """The largest input that the facets leave in states ``x``, shape (S,)."""
        return (self.high[:, :2] @ x.T + self.width * self.high[:, 2:]).min(axis=0)

    def _least(self, x: Array) -> Array:
        """The smallest, shape (S,)."""
        return (self.low[:, :2] @ x.T + self.width * self.low[:, 2:]).max(axis=0)

    def holds(self, x: Array) -> Flags:
        """Whether the facets leave an input in states ``x``, shape (S, 2)."""
        return self._least(x) <= self._most(x) + CLIPPED

    def offsets(self) -> Array:
        """The candidates about the one answer, shape (M,)."""
        places: Array = np.arange(self.size, dtype=np.float64) - 0.5 * (self.size - 1)
        return places * (self.gap * self.width)

    def offers(self, x: Array) -> Array:
        """The candidates in states ``x``, shape (S, M)."""
        u = self.answers(x)
        return u + self.offsets() if self.gap else u

    def solved(self, offer: Array) -> Array:
        """The programs' answers in an offer, shape (M, 1); returns shape (V,)."""
        if not self.gap:
            return offer[:, 0]
        return np.array([offer[:, 0].mean()])

    @property
    def error(self) -> float:
        """By how much an answer may be off."""
        return SLACK * self.spread

    def items(self, offer: Array, noise: float) -> list[Item]:
        """What an offer says of its state: by each piece that may have answered.

        Programs that answered the same answered together.
        """
        answers = self.solved(offer)
        together: list[list[int]] = []
        for p, answer in enumerate(answers.tolist()):
            same = [g for g in together if abs(answers[g[0]] - answer) <= self.error]
            if same:
                same[0].append(p)
            else:
                together.append([p])
        out = []
        for programs in together:
            answer = float(answers[programs[0]])
            pieces = np.unique(np.vstack([self.lines(p) for p in programs]), axis=0)
            level = np.abs(pieces[:, :2]).sum(axis=1) == 0
            if abs(answer) > self.error:
                pieces = pieces[~level]
            elif level.any():
                pieces = pieces[level]
            variance = noise**2 + (EXACT * self.spread) ** 2
            y = answer - pieces[:, 2:]
            out.append(Item(pieces[:, None, :2], y, variance, self._by(programs, pieces)))
        return sorted(out, key=lambda item: -len(item.y))

    def _by(self, programs: list[int], pieces: Array) -> Callable[[Array, Indices], Flags]:
        """Whether these programs all answer by a piece."""

        def holds(x: Array, which: Indices) -> Flags:
            slopes, offsets = pieces[which, :2], pieces[which, 2]
            u = np.einsum("ckn,cn->ck", x, slopes) + offsets[:, None]
            answers = self.answers(x.reshape(-1, 2))[:, programs]
            off = np.abs(answers - u.reshape(-1, 1)).max(axis=1)
            return (off <= self.error).reshape(u.shape)

        return holds

    def forms(self, x: Array) -> list[Form]:
        """What an offer about states ``x``, shape (N, n), is: by the pieces there, or anything."""
        slopes = self._slopes(x)
        g = self.answers(x) - np.einsum("svn,sn->sv", slopes, x)
        G, g = slopes[:, :, None], g[:, :, None]
        return [
            Form(float(np.log(1 - ASTRAY)), G, g, self.error),
            Form(float(np.log(ASTRAY)), G, g, ANYTHING * self.spread),
        ]

    def _slopes(self, x: Array) -> Array:
        """Those of the pieces that answer in states ``x``, shape (S, V, 2)."""
        slopes = np.repeat(self.free[None], len(x), axis=0)
        u = x @ self.free.T
        for facets, side in ((self.high, 1), (self.low, -1)):
            limits = side * (x @ facets[:, :2].T + self.width * facets[:, 2])
            at = limits.argmin(axis=1)
            clipped = side * u > limits.min(axis=1)[:, None]
            slopes = np.where(clipped[:, :, None], facets[at, None, :2], slopes)
        return slopes

    def lines(self, program: int) -> Array:
        """Pieces of a program: u = slope x + offset, shape (P, 3); the free one first."""
        free = np.append(self.free[program], 0.0)[None]
        out = np.vstack([free, self.high, self.low])
        out[1:, 2] *= self.width
        return out

    def explains(self, x: Array, u: Array) -> Array:
        """By how much the law misses answers ``u``, shape (S, V), in states ``x``."""
        return np.abs(self.answers(x) - u).max(axis=1)

    def blur(self, x: Array, noise: float) -> Array:
        """By how much an answer may be off where states ``x`` are read through noise, shape (S,).

        The standard deviation of the steepest piece that answers there, and of reading the answer.
        """
        steep = np.linalg.norm(self._slopes(x), axis=2)
        return noise * np.sqrt(1 + steep.max(axis=1) ** 2)

    def fitted(self, x: Array, u: Array) -> "PlanarLaw":
        """The width under which the law explains answers ``u`` in states ``x`` best."""

        def off(width: float) -> float:
            return float(np.median(self.of_width(width).explains(x, u)))

        width, ratio = 1 / 8, 8.0
        while ratio > 1 + 1e-4:
            widths = width * np.geomspace(1 / ratio, ratio, 81)
            width = min(float(min(widths.tolist(), key=off)), 1.0)
            ratio = ratio ** (1 / 20)
        facets = np.vstack([self.high, self.low])
        found = (u[:, :1] - x @ facets[:, :2].T) / facets[:, 2]
        near = found[np.abs(found / width - 1) < 3e-4]
        return self.of_width(float(np.median(near)) if len(near) > 3 else width)

    def likeliest(self, x: Array, u: Array, noise: float) -> "PlanarLaw":
        """The likeliest width, given answers ``u`` in states ``x``, both read through noise.

        A steep facet makes of a little noise in the state much in the answer, and the tightest of
        several blurred facets lies too low. So states are drawn about each that was heard, and the
        likelihood of its answers averaged over them.
        """
        x, u = x[:MOST_PAIRS], u[:MOST_PAIRS]
        rng = np.random.default_rng(0)
        at = (x[:, None] + noise * rng.standard_normal((len(x), STATES, 2))).reshape(-1, 2)
        free, read = at @ self.free.T, np.repeat(u, STATES, axis=0)
        most, least = at @ self.high[:, :2].T, at @ self.low[:, :2].T

        def likelihood(width: float) -> float:
            above = (most + width * self.high[:, 2]).min(axis=1)
            below = (least + width * self.low[:, 2]).max(axis=1)
            answers = np.maximum(np.minimum(free, above[:, None]), below[:, None])
            by_state = -0.5 * (((read - answers) / noise) ** 2).sum(axis=1)
            by_state = np.maximum(by_state, UNEXPLAINED).reshape(len(x), STATES)
            return float(np.log(np.exp(by_state).mean(axis=1)).sum())

        width, ratio = 1 / 8, 8.0
        while ratio > 1 + 1e-3:
            widths = {min(w, 1.0) for w in (width * np.geomspace(1 / ratio, ratio, 17)).tolist()}
            width = max(sorted(widths), key=likelihood)
            ratio = ratio ** (1 / 4)
        return self.of_width(width)


def _gain(k: Knowledge, A: Array, B: Array) -> Array | None:
    assert k.policy is not None
    if k.policy.gain is not None:
        return np.array(k.policy.gain)
    weights = k.policy.regulator
    if weights is None:
        return None
    from scipy.linalg import solve_discrete_are  # a third of the start of whoever listens

    Q, R = np.diag(weights.next_state), np.diag(weights.input)
    try:
        P = solve_discrete_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError):
        return None
    return np.asarray(-np.linalg.solve(B.T @ P @ B + R, B.T @ P @ A))


def matching(law: PlanarLaw, offers: Sequence[Array]) -> PlanarLaw:
    """The law of that width at which the candidates stand as far apart as they were offered."""
    if not law.gap or not offers:
        return law
    gaps = [np.diff(np.sort(offer[:, 0])).mean() for offer in offers]
    return law.of_width(min(float(np.median(gaps)) / law.gap, 1.0))
