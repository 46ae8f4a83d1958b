"""What a smoother hands on, and how likely each verdict of a step is by it.

The threshold is one for all steps. Under each the verdicts are others, and so are the symbols that
the ciphertext then gives. Those between messages are idle, and the length of a short message begins
with idle ones too. So the weight of the whole transcript, its messages of any bytes, tells most
thresholds from the right one. What remains is cut into a few intervals, each with its share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array
from protocol.schemes.framing import IDLE, LENGTH_BYTES, START, digits_of
from protocol.schemes.table import StateTable
from tap_service.capture.transcript import Transition
from tap_service.inference.lattice import BEGINS, ENDS, SHORT_SHARE


@dataclass(slots=True)
class InferredStep:
    """One transition as it was inferred: equally likely gauges, and the cipher if it was heard.

    ``samples`` has shape (S, M); S = 1 where nothing is uncertain; None where nothing is known.
    """

    transition: Transition
    samples: Array | None


@dataclass(frozen=True)
class Inferred:
    """The steps as inferred.

    Parameters
    ----------
    steps : list of InferredStep
    among : tuple of float
        t_c from and to, in units of D_e.
    """

    steps: list[InferredStep]
    among: tuple[float, float]


def thresholds_above(support: float) -> tuple[float, float]:
    """Thresholds of a defender, by the gauge of the largest disturbance."""
    return 0.95 * support, min(3.0 * support, 1.0)


LIKE_ALONE: Final = 10.0
"""Trajectories that are added, where a step is looked at after another, as it is alone."""

DOUBT: Final = 1e-4
"""Probability that a step's verdict is another where nothing seems to speak for it."""

NEAREST: Final = 1e-4
"""Trajectories that are added for each drawn, in which its nearest candidate was agreed."""

PSEUDO: Final = 0.25
"""Trajectories that are added to those drawn, spread over all verdicts."""


def verdicts_of(
    steps: Sequence[InferredStep], among: tuple[float, float], size: int, *, certain: bool
) -> tuple[Array, Array]:
    """Probability of each step's verdict (none, symbol 0, 1, ...), alone and after the last one.

    Parameters
    ----------
    steps : sequence of InferredStep
    among : tuple of float
        t_c from and to, in units of D_e, evenly.
    size : int
        M.
    certain : bool
        Whether every step agrees.

    Returns
    -------
    alone : array, shape (K, 1 + M)
    after : array, shape (K, M, 1 + M)
        Where the step before agreed on each symbol: trajectories are drawn over several steps, so
        that what one step was says something of the next.
    """
    shares = [_shares(step.samples, among, size, certain=certain) for step in steps]
    alone = np.zeros((len(steps), 1 + size))
    for i, share in enumerate(shares):
        if share is None:
            continue
        alone[i] = share.sum(axis=0)
        more = DOUBT if len(share) == 1 else PSEUDO
        alone[i, 1 if certain else 0 :] += more / (size + 1)
        # if one was agreed all the same, then the nearest
        samples = steps[i].samples
        assert samples is not None
        alone[i, 1:] += NEAREST * np.bincount(samples.argmin(axis=1), minlength=size)
        alone[i] /= alone[i].sum()
    blind = np.array([share is None for share in shares], dtype=bool)
    seen = alone[~blind]
    agreed = 1.0 if certain else (float(seen[:, 1:].sum(axis=1).mean()) if len(seen) else 0.2)
    alone[blind, 0] = 1.0 - agreed
    alone[blind, 1:] = agreed / size
    after = np.repeat(alone[:, None], size, axis=1)
    for i, (before, share) in enumerate(pairwise(shares), 1):
        if before is None or share is None or len(before) != len(share) or len(share) == 1:
            continue
        together = before[:, 1:].T @ share + LIKE_ALONE * alone[i]
        after[i] = together / together.sum(axis=1, keepdims=True)
    return alone, after


def made_of(transitions: Sequence[Transition]) -> Array:
    """Probability that each step was made: that the plant took its offer, shape (K,).

    It is certain where a measurement said so. Elsewhere it is Bayes' rule: by how often the plant
    is known to have missed steps, and by whether she heard an offer. Of a missed step there may
    have been an offer that was lost or late, or none; either is taken for as likely. By offers
    alone nothing tells of a missed step, and each counts as made.
    """
    told = [t for t in transitions if t.applied]
    gaps = sum(t.k > before.k + 1 and not t.gap for before, t in pairwise(transitions))
    unheard = (sum(t.cipher is None for t in told) + 1) / (len(told) + 2)
    out = np.ones(len(transitions))
    for i, t in enumerate(transitions):
        if told and gaps and not t.applied:
            heard = t.cipher is not None
            made = len(told) * ((1 - unheard) if heard else unheard)
            out[i] = made / (made + gaps * ((1 - unheard) if heard else 1 + unheard) / 2)
    return out


def _shares(
    samples: Array | None, among: tuple[float, float], size: int, *, certain: bool
) -> Array | None:
    """Of each trajectory the probability of each verdict, shape (S, 1 + M)."""
    if samples is None:
        return None
    low, high = among
    choice = samples.argmin(axis=1)
    share = np.ones(len(choice))
    if not certain:
        ordered = np.sort(samples, axis=1)
        over = np.minimum(high, ordered[:, 1]) - np.maximum(low, ordered[:, 0])
        share = np.clip(over / max(high - low, 1e-12), 0.0, 1.0) * (ordered[:, -1] <= 1.0)
    out = np.zeros((len(choice), 1 + size))
    out[np.arange(len(choice)), 1 + choice] = share
    out[:, 0] = 1.0 - share
    return out


SAME: Final = 1.1
"""Ratio of the largest threshold to the least up to which they are taken for one."""

CELLS: Final = 48
"""Intervals that are weighed."""

ROUNDS: Final = 3
"""Times that the likely ones are cut anew, at most."""

NEVER: Final = 1e-5
"""Share of the weight up to which an interval is left out."""

LIKE: Final = 0.5
"""Steps whose verdicts differ, as expected, up to which two intervals are one."""

MOST: Final = 8
"""Intervals that are given back."""

Interval = tuple[float, float]
"""Thresholds from and to."""

Cell = tuple[float, float, float]
"""An interval, and its share."""


@dataclass(frozen=True)
class Run:
    """Steps in a row.

    Parameters
    ----------
    steps : list of InferredStep
    entry : array, shape (states,)
        Probability of the scheme's state before the first one.
    made : array, shape (K,)
        Probability that the plant took each step's offer; else the scheme stands still.
    """

    steps: Sequence[InferredStep]
    entry: Array
    made: Array


def likely_thresholds(table: StateTable, runs: Sequence[Run], among: Interval) -> list[Cell]:
    """The intervals of thresholds that remain, in order, :data:`MOST` at most.

    Parameters
    ----------
    table : StateTable
        All its states known.
    runs : sequence of Run
    among : tuple of float
        Thresholds from and to, each as likely.
    """
    low, high = among
    if high < SAME * low:
        return [(*among, 1.0)]
    for _ in range(ROUNDS):
        edges = np.linspace(low, high, CELLS + 1)
        verdicts = [_verdicts(run.steps, edges, table.scheme.alphabet) for run in runs]
        weights = np.sum([weights_of(table, *one) for one in zip(runs, verdicts, strict=True)], 0)
        share = np.exp(weights - np.logaddexp.reduce(weights))
        likely = np.flatnonzero(share > NEVER)
        room = high - low
        low, high = float(edges[likely[0]]), float(edges[likely[-1] + 1])
        if high - low > 0.5 * room:
            break
    others = np.sum([np.abs(np.diff(one, axis=1)).sum(axis=(0, 2)) / 2 for one in verdicts], 0)
    first = 0
    cells: list[Cell] = []
    for i in likely.tolist():
        cell = (float(edges[i]), float(edges[i + 1]), float(share[i]))
        if cells and others[first:i].sum() <= LIKE:
            cells[-1] = _joined(cells[-1], cell)
        else:
            cells.append(cell)
            first = i
    while len(cells) > MOST:
        i = int(np.argmin([a[2] + b[2] for a, b in pairwise(cells)]))
        cells[i : i + 2] = [_joined(cells[i], cells[i + 1])]
    whole = sum(share for _, _, share in cells)
    return [(low, high, share / whole) for low, high, share in cells]


def _joined(a: Cell, b: Cell) -> Cell:
    return a[0], b[1], a[2] + b[2]


def weights_of(table: StateTable, run: Run, verdicts: Array) -> Array:
    """Log weight of a run by each of T thresholds, given its verdicts, shape (K, T, 1 + M)."""
    size, states = table.scheme.alphabet, len(run.entry)
    to = np.zeros((states, size + 1, states))
    for e, following in enumerate(table.all_following()):
        to[e, np.arange(size + 1), following] = 1.0
    moved = _frames(size)
    pads = table.pad[:states]
    carries = np.flatnonzero(pads >= 0)
    now = np.zeros((verdicts.shape[1], states, len(moved[0])))
    now[:, :, 0] = run.entry
    out = np.zeros(len(now))
    for step, verdict, made in zip(run.steps, verdicts, run.made.tolist(), strict=True):
        cipher, still = step.transition.cipher, (1 - made) * now
        for e in carries.tolist():
            symbol = size if cipher is None else (cipher - int(pads[e])) % size
            now[:, e] = now[:, e] @ moved[symbol]
        now = still + made * (np.einsum("tv,evf->tfe", verdict, to) @ now)
        total = now.sum(axis=(1, 2))
        out += np.log(total)
        now /= total[:, None, None]
    return out


def _frames(size: int) -> Array:
    """What each symbol, or any, makes of where in a frame one is; ratios to random symbols.

    Outside, before an upper digit of a length of one byte, or anywhere else inside.
    Shape (M + 1, places, places).
    """
    head = digits_of(LENGTH_BYTES, size) - digits_of(1, size)
    inside = head + 1
    out = np.zeros((size + 1, inside + 1, inside + 1))
    out[:size, inside, inside], out[:size, inside, 0] = 1 - ENDS, ENDS
    out[IDLE, 0, 0] = size * (1 - BEGINS)
    out[START, 0, 1] += size * BEGINS * SHORT_SHARE
    out[START, 0, inside] += size * BEGINS * (1 - SHORT_SHARE)
    out[0, range(1, inside), range(2, inside + 1)] = size
    out[size] = out[:size].mean(axis=0)
    return out


def _verdicts(steps: Sequence[InferredStep], edges: Array, size: int) -> Array:
    """Probability of each verdict by each interval of thresholds; shape (K, intervals, 1 + M)."""
    out = np.zeros((len(steps), len(edges) - 1, 1 + size))
    blind = []
    for i, step in enumerate(steps):
        samples = step.samples
        if samples is None:
            blind.append(i)
            continue
        ordered, choice = np.sort(samples, axis=1), samples.argmin(axis=1)
        under = np.maximum(np.minimum(edges, ordered[:, 1:2]) - ordered[:, :1], 0.0)
        share = np.diff(under * (ordered[:, -1:] <= 1.0), axis=1) / np.diff(edges)
        for symbol in range(size):
            out[i, :, 1 + symbol] = share[choice == symbol].sum(axis=0)
        out[i, :, 0] = len(samples) - out[i].sum(axis=1)
        out[i] += (DOUBT if len(samples) == 1 else PSEUDO) / (size + 1)
        out[i] /= out[i].sum(axis=1, keepdims=True)
    if blind:
        seen = np.delete(out, blind, axis=0)
        agreed = seen[:, :, 1:].sum(axis=2).mean(axis=0) if len(seen) else np.full(CELLS, 0.2)
        out[blind, :, 0], out[blind, :, 1:] = 1.0 - agreed, agreed[:, None] / size
    return out
