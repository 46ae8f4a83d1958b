"""What silence and the heads of frames say of the threshold, which is one for all steps.

Under each threshold the verdicts are others, and so are the symbols that the ciphertext then gives.
Those between messages are idle, and the length of a short message begins with idle ones too. So the
weight of the whole transcript, its messages of any bytes, tells most thresholds from the right one.
What remains is cut into a few intervals, each with its share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array
from protocol.schemes.framing import IDLE, LENGTH_BYTES, START, digits_of
from protocol.schemes.table import StateTable
from tap_service.inference.inferred import InferredStep
from tap_service.inference.lattice import BEGINS, ENDS, SHORT_SHARE
from tap_service.inference.verdicts import DOUBT, PSEUDO

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
