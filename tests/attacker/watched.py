"""The paper's plant under packed candidates and the keyed check, over many runs at once."""

from dataclasses import dataclass

import numpy as np

from attacker_service.base import UNKNOWN, BusAttack, LoopModel, Observation, SensorAttack
from protocol.arrays import Array, Counts, Flags, Integers

A = np.array([[1.0, 0.0975], [0.0, 0.9512]])
B = np.array([[0.0246], [0.4877]])
WIDTHS = np.array([0.12, 0.12])
SPACING = 2.001 * WIDTHS[1] / B[1, 0]
"""Of the candidates: neighbouring predictions are more than two half-widths of D_c apart."""


def box(widths: Array) -> tuple[Array, Array]:
    """The rows of a box."""
    n = len(widths)
    return np.repeat(np.eye(n), 2, 0) * np.tile([1.0, -1.0], n)[:, None], np.repeat(widths, 2)


def model(widths: Array = WIDTHS) -> LoopModel:
    """Who knows all of it."""
    return LoopModel(A, B, *box(widths), *box(np.array([6.0])))


@dataclass
class Watched:
    """What came of the runs: alarm of each step, and how far the truth is from the report."""

    alarms: Flags
    off: Array

    @property
    def undetected(self) -> Array:
        """Share of the runs without an alarm after 1, 2, ... steps."""
        return np.asarray(1 - np.logical_or.accumulate(self.alarms).mean(1))


class Loop:
    """Runs that begin at rest; candidates v + p_b with v = -K of the report, coins drawn evenly."""

    def __init__(self, runs: int, size: int, seed: int, widths: Array = WIDTHS * 0.8) -> None:
        self.rng = np.random.default_rng(seed)
        self.size, self.widths = size, widths
        self.x = np.zeros((runs, 2))
        self.shown = self.x

    def offered(self) -> Array:
        """The candidates at the report, shape (runs, M, 1)."""
        v = -self.shown @ np.array([0.6, 0.9])
        p = SPACING * (np.arange(self.size) - (self.size - 1) / 2)
        return np.asarray((v[:, None] + p)[..., None])

    def moved(self, candidates: Array) -> Counts:
        """One step of the true plant; the coins."""
        coins = self.rng.integers(self.size, size=len(self.x))
        u = candidates[np.arange(len(coins)), coins]
        d = self.rng.uniform(-self.widths, self.widths, self.x.shape)
        self.x = self.x @ A.T + u @ B.T + d
        return coins

    def checked(self, offered: Array, coins: Integers, reported: Array) -> Flags:
        """Whether the report of each run is one that its coin cannot have led to."""
        u = offered[np.arange(len(coins)), coins]
        off = np.abs(reported - self.shown @ A.T - u @ B.T) / WIDTHS
        self.shown = reported
        return np.asarray(off.max(-1) > 1 + 1e-9)


def spoofed(
    attack: SensorAttack,
    steps: int,
    *,
    runs: int = 40_000,
    size: int = 4,
    held: float = 0.0,
    sees: float | None = None,
    seed: int = 1,
    honest: int = 3,
    d: Array = WIDTHS * 0.8,
) -> Watched:
    """Some honest steps, then the attack; she holds a coin with probability ``held``."""
    loop = Loop(runs, size, seed, d)
    alarms, off = [], []
    for k in range(1, honest + steps + 1):
        offered = loop.offered()
        coins = loop.moved(offered)
        hers = np.where(loop.rng.random(runs) < held, coins, UNKNOWN)
        seen = None if sees is None else loop.x + sees * loop.rng.standard_normal(loop.x.shape)
        told = Observation(k, loop.shown, offered, hers, seen)
        if k <= honest:
            attack.watch(loop.x)
            assert not loop.checked(offered, coins, loop.x).any()
            continue
        alarms.append(loop.checked(offered, coins, attack.sensor(told)))
        off.append(np.abs(loop.x - loop.shown).max(-1))
    return Watched(np.array(alarms), np.array(off))


def rewritten(attack: BusAttack, steps: int, *, runs: int = 2000, seed: int = 1) -> Watched:
    """An attack on the bus from the first step on; nobody codes anything."""
    loop = Loop(runs, 4, seed)
    alarms, off = [], []
    for k in range(steps):
        offered = loop.offered()
        coins = loop.moved(attack.toward_plant(k, offered))
        shown = attack.toward_controller(k + 1, loop.x, np.ones(runs, bool))
        alarms.append(loop.checked(offered, coins, shown))
        off.append(np.abs(loop.x - shown).max(-1))
    return Watched(np.array(alarms), np.array(off))
