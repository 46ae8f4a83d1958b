"""The control law as someone who was told the policy can use it: what offers say of the state.

Each candidate minimises a quadratic cost under constraints. Where none is active it is a linear
function of the state, u_i = F_i x (:class:`KnownLaw`). :class:`AffineLaw` takes the law for one
affine function of the state for each candidate, which holds mostly: by the policy's costs, or by
the offers whose state was heard, if these say something else.

Where a constraint is active, the candidate lies on a facet of the target set, and the line
A x + B u meets that facet. The sets depend on D_c, which she does not know; but the terminal set
T_0 that the paper's synthesis gives is the sum of the images of D_c under A + B K, and scales with
D_c. So, with the policy's gain K and the shape of D_e, its facets are known up to one number.
:class:`PlanarLaw` is the law of a planar plant with one input to the last digit: every program
answers u = clip(F x, low(x), high(x)), where the bounds are the facets of the set that the next
state must be in.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from protocol.arrays import Array, Flags, Indices
from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition

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


ENOUGH: Final = 16
"""Pairs of a state and its offer from which a law is fitted."""

ROUNDS: Final = 30
"""Of a fit that lets strays go."""

NEAR: Final = 4
"""Neighbours by which the law is corrected."""

BLURRED: Final = 3.0
"""Deviations of what noise leaves, up to which neighbours correct nothing."""

ASTRAY: Final = 0.03
"""Share of the offers that are as their neighbours, and of those that are anything."""

ANYTHING: Final = 8.0
"""Deviation of an offer that is anything, over the spread of the offers."""

BENT: Final = 1e-4
"""Over the spread of the offers: from here on a law that is exact is bent."""

MOSTLY: Final = 0.75
"""Share of the pairs by which a law is judged."""

LEAST: Final = 1e-7
"""Error of a law that is exact, over the spread of the offers."""


@dataclass(frozen=True)
class Item:
    """A part of an offer, and the ways in which it may have come about: C x = y in each.

    Parameters
    ----------
    C : array, shape (ways, r, n)
    y : array, shape (ways, r)
    variance : float
        Of each reading.
    holds : callable, optional
        Whether the law answers so: of states of shape (N, places, n), a way for each N, the flags.
    """

    C: Array
    y: Array
    variance: float
    holds: Callable[[Array, Indices], Flags] | None = None


@dataclass(frozen=True)
class Form:
    """What is offered about states: u_i = G_i x + g_i, but for an error.

    Parameters
    ----------
    weight : float
        Log probability that it is.
    G : array, shape (N or 1, M, m, n)
    g : array, shape (N or 1, M, m)
    error : float
        Standard deviation.
    """

    weight: float
    G: Array
    g: Array
    error: float


@dataclass(frozen=True)
class AffineLaw:
    """u_i = G_i x + g_i, but for an error.

    Parameters
    ----------
    G : array, shape (M, m, n)
    g : array, shape (M, m)
    error : float
        Standard deviation of what it leaves.
    spread : float
        Of the offers.
    shared : bool
        Whether the candidates stand about one input.
    """

    G: Array
    g: Array
    error: float
    spread: float
    shared: bool
    blur: float = 0.0
    pairs: "Pairs | None" = None

    @classmethod
    def of(
        cls, known: KnownLaw | None, transitions: Sequence[Transition], noise: float
    ) -> "AffineLaw | None":
        """The law by what is known of it and what was heard; None where that is nothing."""
        offers = [t for t in transitions if t.candidates is not None]
        if not offers:
            return None
        u = np.array([t.candidates for t in offers])
        shared = known is not None and known.shared
        offsets = (u - u.mean(axis=1, keepdims=True)).mean(axis=0)
        spread = max(float(u.mean(axis=1).std()) if shared else float(u.std()), 1e-9)
        paired = np.array([t.x is not None for t in offers])
        x = np.array([t.x for t in offers if t.x is not None])
        answers = u[paired]
        tried: list[tuple[float, Array, Array]] = []

        def judged(G: Array, g: Array) -> None:
            left = answers - np.einsum("imn,sn->sim", G, x) - g
            off = np.sqrt((left**2).mean(axis=(1, 2)))
            tried.append((float(np.quantile(off, MOSTLY)), G, g))

        if known is not None:
            G = np.repeat(known.free, len(u[0]), axis=0) if shared else known.free
            g = offsets if shared else np.zeros(u.shape[1:])
            if len(x) < ENOUGH:
                return cls(G, g, LEAST * spread, spread, shared)
            judged(G, g)
        if len(x) >= ENOUGH:
            judged(*_fitted(x, answers, shared=shared))
        if not tried:
            return None
        left, G, g = tried[0]
        if len(tried) > 1 and tried[1][0] < 0.8 * left:
            left, G, g = tried[1]
        blur = noise * np.sqrt((G**2).sum(axis=2).mean() + 1)
        error = np.sqrt(max(left**2 - (1.2 * blur) ** 2, 0.0))
        law = cls(G, g, max(float(error), LEAST * spread), spread, shared, float(blur))
        return replace(law, pairs=Pairs.of(law, x, answers)) if len(x) >= ENOUGH else law

    def forms(self, x: Array) -> list[Form]:
        """What an offer about states ``x``, shape (N, n), may be.

        As the law is as a whole, as offers were whose state was next to it, or anything.
        """
        G = self.G[None]
        out = [Form(float(np.log(1 - 2 * ASTRAY)), G, self.g[None], self.error)]
        if self.pairs is not None:
            left, error = self.pairs.near(x[0])
            if np.abs(left).max() > BLURRED * self.blur + BENT * self.spread:
                error = float(np.sqrt(max(error**2 - self.blur**2, 0.0)))
                near = max(error, self.error)
                out.append(Form(float(np.log(ASTRAY)), G, (self.g + left)[None], near))
        out.append(Form(float(np.log(ASTRAY)), G, self.g[None], ANYTHING * self.spread))
        return out

    def averaged(self, u: Array) -> Array:
        """An offer whose candidates share one input, each misread by itself, with that of all."""
        found: Array = (u - self.g).mean(axis=0) + self.g
        return found

    def items(self, offer: Array, noise: float) -> list[Item]:
        """What an offer says of its state: all candidates together where they share one input."""
        apart = offer - self.g
        if self.shared:
            variance = noise**2 / len(offer) + self.error**2
            return [Item(self.G[:1], apart.mean(axis=0)[None], variance)]
        told = np.abs(self.G).sum(axis=2) > 0
        return [
            Item(G[None, rows], y[None, rows], noise**2 + self.error**2)
            for G, y, rows in zip(self.G, apart, told, strict=True)
            if rows.any()
        ]


class Pairs:
    """What the law left of offers, by their states."""

    def __init__(self, x: Array, left: Array) -> None:
        from scipy.spatial import cKDTree

        self._unit = np.maximum(x.std(axis=0), 1e-12)
        self._tree, self._left = cKDTree(x / self._unit), left

    @classmethod
    def of(cls, law: AffineLaw, x: Array, u: Array) -> "Pairs":
        """The pairs of a law."""
        return cls(x, u - np.einsum("imn,sn->sim", law.G, x) - law.g)

    def near(self, x: Array) -> tuple[Array, float]:
        """What the nearest say, and how far they differ."""
        found, at = (np.asarray(one) for one in self._tree.query(x / self._unit, NEAR))
        weight = 1 / (found + 0.3 * found[-1] + 1e-12)
        weight /= weight.sum()
        left = self._left[at]
        mean = np.einsum("s,sim->im", weight, left)
        error = np.sqrt(np.einsum("s,sim->im", weight, (left - mean) ** 2).mean())
        return mean, float(error)


def _fitted(x: Array, u: Array, *, shared: bool) -> tuple[Array, Array]:
    """Affine functions that leave most pairs the least."""
    phi = np.hstack([x, np.ones((len(x), 1))])
    target = u.mean(axis=1) if shared else u.reshape(len(u), -1)
    weight = np.ones(len(x))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        theta = np.linalg.lstsq(root * phi, root * target, rcond=None)[0]
        off = np.abs(target - phi @ theta).max(axis=1)
        weight = 1 / (off + 1e-6 * off.mean() + 1e-12)
    size, m = u.shape[1:]
    if not shared:
        G = theta[:-1].T.reshape(size, m, -1)
        return G, theta[-1].reshape(size, m)
    offsets = (u - u.mean(axis=1, keepdims=True)).mean(axis=0)
    return np.repeat(theta[:-1].T[None], size, axis=0), theta[-1] + offsets


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
        found: Array = (self.high[:, :2] @ x.T + self.width * self.high[:, 2:]).min(axis=0)
        return found

    def _least(self, x: Array) -> Array:
        """The smallest, shape (S,)."""
        found: Array = (self.low[:, :2] @ x.T + self.width * self.low[:, 2:]).max(axis=0)
        return found

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
            found: Flags = (off <= self.error).reshape(u.shape)
            return found

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
        found: Array = np.abs(self.answers(x) - u).max(axis=1)
        return found

    def blur(self, x: Array, noise: float) -> Array:
        """By how much an answer may be off where states ``x`` are read through noise, shape (S,).

        The standard deviation of the steepest piece that answers there, and of reading the answer.
        """
        steep = np.linalg.norm(self._slopes(x), axis=2)
        found: Array = noise * np.sqrt(1 + steep.max(axis=1) ** 2)
        return found

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
