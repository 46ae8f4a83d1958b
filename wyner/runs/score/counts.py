"""What a plant's trace adds up to: control cost, and messages."""

from collections.abc import Iterator, Sequence

import numpy as np

from protocol.arrays import Array
from protocol.scenario import ScenarioError
from protocol.vectors import Vector
from wyner.runs.run import Run
from wyner.runs.trace import AT_ONCE, Rows, Trace


def mean_cost(rows: Rows, weights: tuple[Vector, Vector]) -> float | None:
    """The control cost a step of these rows of a plant's trace; None where there are none."""
    cost = 0.0
    for part in parted(rows):
        cost = total(cost, costs(weights, part))
    return cost / len(rows) if len(rows) else None


def recovered(trace: Trace) -> list[tuple[int, bytes]]:
    """Each message that the plant had whole, with the step of its session at which it was."""
    return [(trace.newest_k(at), told.payload) for at, told in trace.noted("recovered")]


def parted(rows: Rows) -> Iterator[Rows]:
    """Rows, some at a time."""
    for first in range(0, len(rows), AT_ONCE):
        yield rows[first : first + AT_ONCE]


def costs(weights: tuple[Vector, Vector], rows: Rows) -> Array:
    """x(k+1)' Q x(k+1) + u(k)' R u(k) of each step, ``weights`` the diagonals of Q and R.

    It is that of the true state and input, where they are told.
    """
    state, effort = weights
    truth = truth_of(rows)
    x, u = (rows["x_next"], rows["u"]) if truth is None else (truth, rows["true_u"])
    if truth is not None:
        silent = np.isnan(truth[:, :1])
        u = np.where(silent, rows["u"], u)
        x = np.where(silent, rows["x_next"], x) if x.shape == rows["x_next"].shape else x
    return _weighed(state, x) + _weighed(effort, u)


def _weighed(weights: Vector, values: Array) -> Array:
    """Of each row the sum of its weighed squares, in the order of its columns."""
    found: Array = np.zeros(len(values))
    for weight, column in zip(weights, values.T, strict=False):
        found += weight * column * column
    return found


def total(start: float, values: Array) -> float:
    """``start`` and all values, added one after another: the same sum in parts of any size."""
    return float(np.add.accumulate(np.append(start, values))[-1])


def truth_of(rows: Rows) -> Array | None:
    """The true states after the steps; None where nobody told them."""
    told = "true_x" in (rows.dtype.names or ())
    return rows["true_x"] if told else None


def exchanged(sent: list[bytes], recovered: Sequence[tuple[int, bytes]]) -> list[tuple[bytes, int]]:
    """Each message that was sent, in order, with the step at which the plant had it; -1 never.

    What came a second time, after a journal was lost, is the same message.
    """
    place = 0
    found = [(payload, -1) for payload in sent]
    for k, payload in recovered:
        at = next((i for i in range(place, len(sent)) if sent[i] == payload), None)
        if at is not None:
            found[at] = (payload, k)
            place = at + 1
    return found


def cost_of(run: Run) -> float | None:
    """The control cost a step of a run's plant.

    None without a step, and where the run's scenario is gone, which holds the weights.

    Raises
    ------
    runtime.recording.TraceError
        When the plant's trace cannot be read.
    """
    try:
        weights = run.scenario.cost_weights
    except ScenarioError:
        return None
    return mean_cost(run.whole("plant").steps, weights)
