"""The share of missed steps that a network leads to expect, computed from its distributions.

A step is missed when none of its copies makes the round trip in time. How many copies it has
depends on one number of the past: when the first late offer of a missed step comes, for from then
on a measurement goes out once, until an offer comes in time. In units of the time between two
copies that number is a state of a finite Markov chain, together with both directions' states of
loss; its stationary distribution gives the share.
"""

from collections.abc import Callable
from math import ceil
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from protocol.arrays import Array
from protocol.scenario import ChannelTable, Scenario
from runtime.network import MOST_PERIODS, measured_delays

QUANTILES: Final = 4000
"""Equally likely delays of one direction, over which the round trip's distribution is summed."""

EDGE: Final = 1e-9
"""Of a step: an offer that comes with the tick is too late."""


class _Way(NamedTuple):
    """One direction: the distribution of its delay in seconds, and its losses."""

    below: Callable[[Array], Array]
    quantiles: Array
    table: ChannelTable


def _way(table: ChannelTable, folder: Path) -> _Way:
    shares = (np.arange(QUANTILES) + 0.5) / QUANTILES
    middle, spread = table.delay_s, table.jitter_s
    measured = np.sort(measured_delays(table, folder))
    if table.delay == "measured":
        count = len(measured)
        quantiles = measured if count <= QUANTILES else np.quantile(measured, shares)
        return _Way(lambda x: np.searchsorted(measured, x) / count, quantiles, table)
    if table.delay == "gamma":
        from scipy.stats import gamma

        law = gamma((middle / spread) ** 2, scale=spread**2 / middle)
        return _Way(law.cdf, law.ppf(shares), table)
    if table.delay == "uniform" and spread:
        low = middle - spread
        return _Way(
            lambda x: np.clip((x - low) / (2 * spread), 0.0, 1.0),
            low + 2 * spread * shares,
            table,
        )
    return _Way(lambda x: (x > middle).astype(float), np.array([middle]), table)


def expected_missed_share(scenario: Scenario, folder: Path = Path()) -> float | None:
    """The share of missed steps in the long run; None where the scenario has no network.

    Exact for messages that may overtake one another, but for the numbers' rounding and for answers
    to a measurement that a newer one overtook, which count here as late offers.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Where the file of measured delays is looked for.
    """
    network = scenario.network
    if network is None:
        return None
    period, copies = scenario.plant.period_s, scenario.link.repeats_per_period
    ways = (_way(network.to_controller, folder), _way(network.to_plant, folder))
    longest = sum(w.table.longest_s(measured_delays(w.table, folder)) for w in ways)
    cells = copies * min(MOST_PERIODS, ceil(longest / period) + 1)
    sending = sum(w.table.sending_s for w in ways)
    gap = period / copies
    times = np.arange(1, copies + cells + 1) * gap * (1 - EDGE) - sending
    arrived = np.array([ways[0].below(t - ways[1].quantiles).mean() for t in times])
    good = [(1 - w.table.chain.loss_good, 1 - w.table.chain.loss_bad) for w in ways]
    states = [(up, down) for up in (0, 1) for down in (0, 1)]
    changes = np.kron(_changes(ways[0].table), _changes(ways[1].table))
    size = cells + 2  # cells of time, 0 for "came already", and the last for "none comes"
    move = np.zeros((4, size, 4, size))
    miss = np.zeros((4, size))
    for s, (up, down) in enumerate(states):
        inner = np.zeros((size, size))
        for cell in range(size):
            inner[cell] = _after(cell, arrived * good[0][up] * good[1][down], copies, cells)
        miss[s] = inner.sum(axis=1)
        inner[:, -1] += 1.0 - miss[s]
        for after in range(4):
            move[s, :, after, :] = changes[s, after] * inner
    stay = stationary(move.reshape(4 * size, 4 * size))
    return float(stay @ miss.ravel())


def _changes(table: ChannelTable) -> Array:
    """How the state of loss changes from one step to the next, shape (2, 2)."""
    g, b = table.chain.to_bad, table.chain.to_good
    return np.array([[1 - g, g], [b, 1 - b]])


def _after(cell: int, arrived: Array, copies: int, cells: int) -> Array:
    """The share of steps that are missed, by the cell in which the next step finds itself.

    Parameters
    ----------
    cell : int
        In which cell of this step the first late offer comes; 0: before it, cells + 1: never.
    arrived : array, shape (copies + cells,)
        Probability that a copy's offer has come 1, 2, ... gaps after the copy went out.
    copies, cells : int
    """
    out = np.zeros(cells + 2)
    sent = np.arange(min(cell + 1, copies))
    if cell <= copies:
        out[0] = np.prod(1.0 - arrived[copies - 1 - sent])
        return out
    # the probability that no offer of this step has come m gaps after its end
    none = np.array([np.prod(1.0 - arrived[copies - 1 + m - sent]) for m in range(cells + 1)])
    if cell <= cells:
        none[cell - copies :] = 0.0
    out[1 : cells + 1] = none[:-1] - none[1:]
    out[cells + 1] = none[-1]
    return out


def stationary(move: Array) -> Array:
    """The stationary distribution of a chain with one recurrent class.

    Parameters
    ----------
    move : array, shape (n, n)
        Rows sum to 1.
    """
    n = len(move)
    system = np.vstack([move.T - np.eye(n), np.ones(n)])
    right = np.append(np.zeros(n), 1.0)
    found, *_ = np.linalg.lstsq(system, right, rcond=None)
    shares = np.clip(found, 0.0, None)
    out: Array = shares / shares.sum()
    return out
