"""What a plant's trace adds up to, line by line."""

import base64
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import ScenarioError
from protocol.vectors import Vector
from wyner.runs.run import Run
from wyner.runs.trace import Rows


@dataclass(slots=True)
class PlantCounts:
    """Counts of a plant's trace, of the events that count (:meth:`wyner.runs.run.Run.feed`).

    Parameters
    ----------
    weights : pair of tuple of float, shapes (n,) and (m,)
        Diagonals of Q and R.
    steps : int
        Steps that were made, missed ones included, by every journal that the plant had.
    transitions : int
    agreements : int
        Transitions that agreed a key symbol.
    symbol_errors : int
        Agreements on another symbol than the coin.
    cost : float
        Sum over steps of x(k+1)' Q x(k+1) + u(k)' R u(k), where ``weights`` are given.
    message_symbols : int
        Transitions that carried a message symbol.
    recovered : list of (int, bytes)
        Each message that was whole, with the step at which it was.
    without : array of int
        Steps that were missed, in order.
    """

    weights: tuple[Vector, Vector] = ((), ())
    steps: int = 0
    cost: float = 0.0
    transitions: int = 0
    agreements: int = 0
    symbol_errors: int = 0
    message_symbols: int = 0
    recovered: list[tuple[int, bytes]] = field(default_factory=list)
    without: "array[int]" = field(default_factory=lambda: array("q"))
    _last_k: int = -1

    @property
    def mean_cost(self) -> float | None:
        """The control cost a step; None before the first."""
        return self.cost / self.steps if self.steps else None

    def take(self, event: Mapping[str, Any]) -> None:
        """Take the next event."""
        kind = event["event"]
        if kind == "transition":
            symbol, coin, carried = event["symbol"], event["coin"], event["message_symbol"]
            self._last_k = int(event["k"])
            self.steps += 1
            self._judge(event)
            self.transitions += 1
            self.agreements += symbol != NO_SYMBOL
            self.symbol_errors += symbol not in (NO_SYMBOL, coin)
            self.message_symbols += carried != NO_SYMBOL
        elif kind in ("missed", "interrupted"):
            self.steps += 1
            self.without.append(int(event["k"]))
            self._judge(event)
        elif kind == "recovered":
            self.recovered.append((self._last_k, base64.b64decode(event["payload"])))

    def _judge(self, event: Mapping[str, Any]) -> None:
        """Add a step's cost: of the state itself and the input applied, where they are told."""
        x_next = event.get("true_x_next", event["x_next"])
        self.cost += step_cost(self.weights, x_next, event.get("true_u", event["u"]))


def step_cost(weights: tuple[Vector, Vector], x_next: Sequence[float], u: Sequence[float]) -> float:
    """What a step costs: x(k+1)' Q x(k+1) + u(k)' R u(k), ``weights`` the diagonals of Q and R."""
    state, effort = weights
    return sum(q * v * v for q, v in zip(state, x_next, strict=False)) + sum(
        r * v * v for r, v in zip(effort, u, strict=False)
    )


def costs(weights: tuple[Vector, Vector], rows: Rows) -> Array:
    """The same of every step of a plant's trace: of the truth, where it is told."""
    state, effort = weights
    truth = truth_of(rows)
    x, u = (rows["x_next"], rows["u"]) if truth is None else (truth, rows["true_u"])
    if truth is not None:
        silent = np.isnan(truth[:, :1])
        u = np.where(silent, rows["u"], u)
        x = np.where(silent, rows["x_next"], x) if x.shape == rows["x_next"].shape else x
    found: Array = (x**2 @ np.array(state[: x.shape[1]])) + (u**2 @ np.array(effort[: u.shape[1]]))
    return found


def truth_of(rows: Rows) -> Array | None:
    """The true states after the steps; None where nobody told them."""
    told = "true_x" in (rows.dtype.names or ())
    return rows["true_x"] if told else None


def exchanged(sent: list[bytes], recovered: list[tuple[int, bytes]]) -> list[tuple[bytes, int]]:
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
        counts = PlantCounts(run.scenario.cost_weights)
    except ScenarioError:
        return None
    run.feed("plant", counts.take)
    return counts.mean_cost
