"""What she learns from outputs: how far the disturbance and the sensors scatter, or a whole model.

Both from readings alone and from the candidates that her filter takes for applied. The deviations
are those under which the readings surprise the filter least. A model is sought among regressions

    y(k+1) = a_1 y(k) + ... + a_p y(k-p+1) + b_1 u(k) + ... + b_p u(k-p+1) + e,

each of which is a plant whose first states are read: so the same filter serves, and the candidates
that it takes for applied give the next regression. It begins from the candidates' mean, by
instruments that are older than any coin in the residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition
from tap_service.inference.output_model import LATER, OutputModel

NEWEST_STEPS: Final = 256
"""Newest transitions that deviations are fitted to."""

ROUNDS: Final = 6
"""Rounds in which each deviation is multiplied by each factor in turn, at most."""

FACTORS: Final = (0.25, 0.5, 0.8, 1.25, 2.0, 4.0)
"""By which a deviation is multiplied; the least may be no less than FLOOR of the first."""

FLOOR: Final = 1e-4

ORDERS: Final = (1, 2, 3, 4)
"""Numbers p of readings that a model looks back."""

FITS: Final = 4
"""Regressions and filters in turn, at most."""

SURE: Final = 256
"""Transitions from which the model found before is only made better."""

NEAR: Final = 3.0
"""Times the median length from which a row of a regression counts less."""

PRICE: Final = 10.0
"""Log likelihood that one more reading to look back must be worth."""


@dataclass(frozen=True)
class Stretch:
    """Transitions in a row that were heard whole, and what was applied in them.

    Parameters
    ----------
    y : array, shape (K + 1, r)
    means : array, shape (K, m)
        Of the candidates.
    u : array, shape (K, m)
        As she takes them to be applied.
    """

    y: Array
    means: Array
    u: Array


def stretches(transitions: Sequence[Transition], applied: Sequence[int | None]) -> list[Stretch]:
    """Runs of transitions that were heard whole, each beginning where the one before ended.

    Parameters
    ----------
    applied : sequence of int, optional
        The candidate applied in each; None where she knows none, and a run ends.
    """
    runs: list[list[tuple[Transition, int]]] = []
    before: Transition | None = None
    for t, symbol in zip(transitions, applied, strict=True):
        if not t.whole or symbol is None:
            before = None
            continue
        if before is None or t.start or t.gap or t.k != before.k + 1:
            runs.append([])
        runs[-1].append((t, symbol))
        before = t
    out = []
    for run in runs:
        offers = np.array([t.candidates for t, _ in run])
        symbols = np.array([symbol for _, symbol in run])
        y = np.array([run[0][0].x, *(t.x_next for t, _ in run)])
        out.append(Stretch(y, offers.mean(axis=1), offers[np.arange(len(run)), symbols]))
    return out


def applied_in(model: OutputModel, transitions: Sequence[Transition]) -> list[int | None]:
    """The candidate applied in each transition, as the model's likeliest sequence has it."""
    model = model.anew()
    out: list[int | None] = []
    for t in transitions:
        model.observe(t)
        out.append(None)
        # the newest may be corrected by what comes after
        for back, symbol in enumerate(reversed(model.applied[-LATER - 1 :]), 1):
            if back <= len(out):
                out[-back] = None if symbol < 0 else symbol
    return out


# --- deviations -----------------------------------------------------------------------------------


def fitted_deviations(
    model: OutputModel, parts: Sequence[Stretch], *, each: bool
) -> tuple[Array, Array, float]:
    """Deviations of disturbance and sensors that explain the readings best.

    Parameters
    ----------
    model : OutputModel
        Whose deviations it begins from.
    parts : sequence of Stretch
    each : bool
        Whether each of the disturbance is sought by itself; else all by one factor.

    Returns
    -------
    deviations : array, shape (n,)
    sensors : array, shape (r,)
    float
        Log likelihood of the readings.
    """
    n, r = len(model.A), len(model.C)
    parts = _newest(parts)
    groups = [*np.eye(n + r)[: n if each else 0], *([] if each else [_first(n, n + r)])]
    groups += [*np.eye(n + r)[n:]]
    start = np.concatenate([model.deviations, model.sensors])
    least = FLOOR * np.concatenate([model.deviations, np.abs(np.array(model.C)) @ model.widths])
    best, found = start, -np.inf
    for _ in range(ROUNDS):
        tried = [best]
        for group in groups:
            tried += [np.maximum(best * factor**group, least) for factor in FACTORS]
        scores = _likelihoods(model, parts, np.array(tried))
        at = int(scores.argmax())
        found, better = float(scores[at]), tried[at]
        if at == 0:
            break
        best = better
    return best[:n], best[n:], found


def _first(n: int, size: int) -> Array:
    return (np.arange(size) < n).astype(float)


def _newest(parts: Sequence[Stretch]) -> list[Stretch]:
    """The newest transitions, the last run cut short."""
    out: list[Stretch] = []
    left = NEWEST_STEPS
    for part in reversed(parts):
        count = min(len(part.u), left)
        if count < 1:
            break
        out.append(Stretch(part.y[-count - 1 :], part.means[-count:], part.u[-count:]))
        left -= count
    return out[::-1]


def _likelihoods(model: OutputModel, parts: Sequence[Stretch], tried: Array) -> Array:
    """Log likelihood of the readings under each of some deviations, shape (G,).

    The first readings of a run, as many as there are states, tell where the state is, and no more.
    """
    A, B, C = np.array(model.A), np.array(model.B), np.array(model.C)
    n, G = len(A), len(tried)
    Q = np.square(tried[:, :n, None]) * np.eye(n)
    own = np.square(tried[:, n:]) + model.noise**2
    R = own[:, :, None] * np.eye(len(C))
    total = np.zeros(G)
    for part in parts:
        means = np.zeros((G, n))
        spread = np.tile(model.far, (G, 1, 1))
        for k, y in enumerate(part.y):
            S = C @ spread @ C.T + R
            inverse = np.linalg.inv(S)
            gain = spread @ C.T @ inverse
            surprise = y - means @ C.T
            if k > n:
                total -= 0.5 * np.einsum("gr,grs,gs->g", surprise, inverse, surprise)
                total -= 0.5 * np.log(np.linalg.det(S))
            means = means + np.einsum("gnr,gr->gn", gain, surprise)
            spread = spread - gain @ C @ spread
            spread = 0.5 * (spread + spread.transpose(0, 2, 1))
            if k < len(part.u):
                means = means @ A.T + B @ part.u[k]
                spread = A @ spread @ A.T + Q
    return total


def refitted(model: OutputModel, transitions: Sequence[Transition]) -> OutputModel:
    """The model with deviations that explain the newest readings best."""
    newest = transitions[-NEWEST_STEPS - LATER :]
    made = model.anew()
    for _ in range(FITS):
        before = made.deviations
        parts = stretches(newest, applied_in(made, newest))
        if not parts:
            break
        deviations, sensors, _ = fitted_deviations(made, parts, each=False)
        made.assume(deviations, sensors)
        if np.allclose(deviations, before):
            break
    return made


# --- a model --------------------------------------------------------------------------------------


def identified(
    transitions: Sequence[Transition], noise: float, before: OutputModel | None
) -> OutputModel | None:
    """A model of the plant, from its readings and offers alone; None where they are too few.

    Parameters
    ----------
    transitions : sequence of Transition
    noise : float
        Standard deviation of what her receiver adds.
    before : OutputModel, optional
        One that was found before.
    """
    transitions = transitions[-2 * NEWEST_STEPS :]
    parts = stretches(transitions, [0] * len(transitions))
    found: list[tuple[float, OutputModel]] = []
    if before is not None:
        found += _settled(transitions, before, noise)
    if before is None or len(transitions) < SURE:
        for order in ORDERS:
            theta = _by_instruments(parts, order)
            if theta is None:
                break
            best = max((score for score, _ in found), default=-np.inf)
            turned = theta.copy()
            turned[order * theta.shape[1] :] *= -1
            for start in (theta, turned):  # in a closed loop the sign of B hardly shows
                found += _settled(transitions, _model(start, parts, order, noise), noise)
            if max((score for score, _ in found), default=-np.inf) <= best:
                break
    return max(found, key=lambda one: one[0])[1] if found else None


def _settled(
    transitions: Sequence[Transition], model: OutputModel, noise: float
) -> list[tuple[float, OutputModel]]:
    """Filters and regressions in turn, until what was applied is the same; the likelihood too."""
    order = len(model.A) // len(model.C)
    symbols: list[int | None] = []
    score = -np.inf
    for _ in range(FITS):
        again = applied_in(model, transitions)
        if again == symbols:
            break
        symbols = again
        parts = stretches(transitions, symbols)
        theta = _by_choices(parts, order)
        if theta is None:
            return []
        model = _model(theta, parts, order, noise)
        deviations, sensors, score = fitted_deviations(model, parts, each=True)
        model.assume(deviations, sensors)
    return [(score - PRICE * order, model)]


def _rows(part: Stretch, order: int, inputs: Array) -> tuple[Array, Array]:
    """Regressors, y and u, and the readings after them."""
    K = len(inputs)
    rows = [
        np.concatenate([
            *(part.y[k - i] for i in range(order)), *(inputs[k - i] for i in range(order))
        ])
        for k in range(order - 1, K)
    ]  # fmt: skip
    return np.array(rows), part.y[order:]


def _by_choices(parts: Sequence[Stretch], order: int) -> Array | None:
    """Least squares with the inputs as they were applied.

    A session starts far from where it stays, and one candidate taken wrongly there would turn the
    whole model: so a row counts by its length, as Mallows has it.
    """
    rows = [_rows(part, order, part.u) for part in parts if len(part.u) >= order]
    if not rows:
        return None
    phi, y = (np.concatenate(side) for side in zip(*rows, strict=True))
    if len(phi) < 2 * phi.shape[1]:
        return None
    length = np.linalg.norm(phi / np.maximum(np.median(np.abs(phi), axis=0), 1e-12), axis=1)
    weight = np.minimum(1.0, NEAR * np.median(length) / length)[:, None]
    return _solved(weight * phi, weight * y)


def _solved(phi: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(phi, y, rcond=None)[0], dtype=np.float64)


def _by_instruments(parts: Sequence[Stretch], order: int) -> Array | None:
    """The regression on the candidates' mean; coins of ``order`` steps are in what it leaves.

    Readings and offers of the first of these steps were made before its coin: they are the
    instruments.
    """
    phis, instruments, ys = [], [], []
    for part in parts:
        if len(part.u) < 2 * order:
            continue
        phi, y = _rows(part, order, part.means)
        phis.append(phi[order - 1 :])
        instruments.append(phi[: len(phi) - order + 1])
        ys.append(y[order - 1 :])
    if not phis:
        return None
    phi, Z, y = np.concatenate(phis), np.concatenate(instruments), np.concatenate(ys)
    if len(phi) < 2 * phi.shape[1]:
        return None
    return _solved(Z.T @ phi, Z.T @ y)


def _model(theta: Array, parts: Sequence[Stretch], order: int, noise: float) -> OutputModel:
    """The plant whose first states are read: those after them carry what is still to come."""
    r, m = theta.shape[1], parts[0].u.shape[1]
    n = r * order
    A, B = np.zeros((n, n)), np.zeros((n, m))
    for i in range(order):
        A[r * i : r * i + r, :r] = theta[r * i : r * i + r].T
        B[r * i : r * i + r] = theta[n + m * i : n + m * i + m].T
    A[: n - r, r:] += np.eye(n - r)
    C = np.eye(r, n)
    left = np.concatenate([
        y - phi @ theta
        for phi, y in (_rows(part, order, part.u) for part in parts if len(part.u) >= order)
    ])  # fmt: skip
    width = np.maximum(np.abs(left).mean(axis=0), 1e-12)
    widths = tuple(np.tile(width, order).tolist())
    return OutputModel(_matrix(A), _matrix(B), _matrix(C), widths, noise=noise)


def _matrix(rows: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in rows.tolist())
