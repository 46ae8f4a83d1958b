"""What a plant's trace adds up to."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import ScenarioError
from protocol.vectors import Vector
from wyner.runs.run import Run
from wyner.runs.trace import AT_ONCE, TRANSITION, Rows, Trace


@dataclass(frozen=True, slots=True)
class PlantCounts:
    """Counts of a plant's trace.

    Parameters
    ----------
    steps : int
        Steps that were made, missed ones included, by every journal that the plant had.
    cost : float
        Sum over steps of x(k+1)' Q x(k+1) + u(k)' R u(k).
    transitions : int
    agreements : int
        Transitions that agreed a key symbol.
    symbol_errors : int
        Agreements on another symbol than the coin.
    message_symbols : int
        Transitions that carried a message symbol.
    recovered : list of (int, bytes)
        Each message that was whole, with the step at which it was.
    without : list of int
        Steps that were missed, in order.
    """

    steps: int = 0
    cost: float = 0.0
    transitions: int = 0
    agreements: int = 0
    symbol_errors: int = 0
    message_symbols: int = 0
    recovered: Sequence[tuple[int, bytes]] = ()
    without: Sequence[int] = ()

    @classmethod
    def of(cls, trace: Trace, weights: tuple[Vector, Vector]) -> Self:
        """Those of a trace; ``weights`` are the diagonals of Q and R."""
        whole = [(trace.newest_k(at), told.payload) for at, told in trace.noted("recovered")]
        return cls.of_rows(trace.steps, weights, whole)

    @classmethod
    def of_rows(
        cls,
        rows: Rows,
        weights: tuple[Vector, Vector],
        recovered: Sequence[tuple[int, bytes]] = (),
    ) -> Self:
        """Those of some rows of a trace."""
        counted, agreed = rows["kind"] == TRANSITION, rows["symbol"] != NO_SYMBOL
        cost = 0.0
        for part in parted(rows):
            cost = total(cost, costs(weights, part))
        return cls(
            len(rows),
            cost,
            int(counted.sum()),
            int(agreed.sum()),
            int((agreed & (rows["symbol"] != rows["coin"])).sum()),
            int((rows["message_symbol"] != NO_SYMBOL).sum()),
            recovered,
            rows["k"][~counted].tolist(),
        )

    @property
    def mean_cost(self) -> float | None:
        """The control cost a step; None before the first."""
        return self.cost / self.steps if self.steps else None


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
    return PlantCounts.of(run.whole("plant"), weights).mean_cost
