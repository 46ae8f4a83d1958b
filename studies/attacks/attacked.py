"""Attacked runs, many at once: the attacker's own classes against what both ends do with a key.

They stand between the ends of :func:`~wyner.simulate.engine.loop.simulate_runs`. A step is the
services': the controller offers for what it was shown, the plant applies one candidate, its reading
passes the attacker, the wire and the defences, and is tested. Steps are counted from the onset:
step 1 is the first reading that she may change.

The keyed coin and the residual test are what a live controller has. Two known ideas stand beside
them: each measurement turned by a rotation of its own, and a tag on each. Who rewrites a message
without its key passes the tag of 32 bits once in some 10^8 messages: here, never.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from attacker_service.base import (
    UNKNOWN,
    ActuatorAttack,
    Attack,
    BusAttack,
    Observation,
    SensorAttack,
)
from controller_service.laws.base import CandidateLaw
from protocol.agreement import INSIDE
from protocol.arrays import Array, Counts, Flags, Integers
from protocol.scenario import Scenario
from wyner.simulate.engine.draws import disturbances
from wyner.simulate.engine.loop import Between, simulate_runs

ONSET: Final = 30
"""Honest steps before an attack, where none are stated: the loop has settled."""

Kind = Callable[[np.random.Generator], Attack]
"""Makes the attack of one simulation with the generator that it draws from."""


@dataclass(frozen=True, eq=False)
class Attacked:
    """What became of each run.

    Parameters
    ----------
    steps : int
        Attacked steps.
    alarmed : int array, shape (R,)
        The attacked step of the first alarm, 0 where there was none.
    false_alarms : int
        Honest steps, of all runs, that alarmed.
    away : array, shape (R,)
        abs(x - x') at the first alarm, else at the end.
    shown : array, shape (R,)
        The largest abs(x') that was shown under attack up to there.
    """

    steps: int
    alarmed: Counts
    false_alarms: int
    away: Array
    shown: Array

    def undetected(self) -> Counts:
        """Runs without an alarm after 0, 1, 2, ... attacked steps, shape (steps + 1,)."""
        caught = np.bincount(self.alarmed, minlength=self.steps + 1)
        caught[0] = 0
        out: Counts = len(self.alarmed) - np.cumsum(caught)
        return out


@dataclass(frozen=True, eq=False)
class Keys:
    """The keys of a simulation, and what of them she has.

    Parameters
    ----------
    held : bool array, shape (R,)
        Runs whose keys she has. Of the others she has other keys, uniform and her own.
    digits : int array, shape (steps, R), optional
        Digits of a keyed coin that are given, and not drawn, from the first step on.
    believed : int array, shape (steps, R), optional
        What she takes them for; :data:`~attacker_service.base.UNKNOWN` where she does not know.
    """

    held: Flags
    digits: Integers | None = None
    believed: Integers | None = None


KEY_BITS: Final[dict[str, Callable[[int], float]]] = {
    "keyed-coin": math.log2,
    "coding": lambda _: 32.0,
    "mac": lambda _: 64.0,
}
"""The defences besides the residual test, and the bits of key that each takes in a step at M.

``keyed-coin``: a digit names the candidate; an alarm where that does not explain the transition.
``coding``: x(k) travels as S(k) x(k); two states. Who rewrites it must turn her correction e
likewise. Turned by another matrix T it leaves e - S^T T e in what the controller reads, as long as
2 sin(phi / 2) abs(e) for an angle phi between them. So a correction within D_c goes unseen, and so
does any that is made before the plant's end turns the reading.
``mac``: each message, offers too, has a tag; an alarm where a measurement was rewritten.
"""


class _Step(NamedTuple):
    """The keys of a step, those that are in use: a digit, shape (R, 1), and a rotation S."""

    digit: Integers | None
    rotation: Array | None


def rotations(words: NDArray[np.uint32]) -> Array:
    """Rotations of the plane by 2 pi w / 2^32, shape (R,) to (R, 2, 2)."""
    angle = 2 * math.pi * (words.astype(np.float64) + 0.5) / 2.0**32
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((np.stack((c, -s), -1), np.stack((s, c), -1)), -2)


def turned(S: Array, x: Array) -> Array:
    """S x, shapes (R, 2, 2) and (R, 2)."""
    out: Array = (S @ x[..., None])[..., 0]
    return out


def back(S: Array) -> Array:
    """The rotations the other way."""
    return np.swapaxes(S, -1, -2)


class _Ends:
    """Both ends' defences with their keys, and what she makes of these.

    A key of a step serves the measurement x(k), the offer that answers it, and the test of what
    comes of that offer.
    """

    def __init__(
        self,
        defences: Sequence[str],
        candidates: int,
        keys: Keys,
        secret: np.random.Generator,
        hers: np.random.Generator,
    ) -> None:
        self._defences, self._candidates = defences, candidates
        self._keys, self._secret, self._hers = keys, secret, hers
        self.runs = len(keys.held)
        self._following = self._shared(0)
        self._step = self._following

    def _drawn(self, draw: np.random.Generator) -> _Step:
        """Keys of a step, uniform."""
        digit = rotation = None
        for name in self._defences:
            if name == "keyed-coin":
                digit = draw.integers(self._candidates, size=(self.runs, 1))
            elif name == "coding":
                rotation = rotations(draw.integers(1 << 32, size=self.runs, dtype=np.uint32))
        return _Step(digit, rotation)

    def _shared(self, k: int) -> _Step:
        """Keys of step k at both ends."""
        step, given = self._drawn(self._secret), self._keys.digits
        if given is None or k >= len(given):
            return step
        return step._replace(digit=given[k][:, None])

    def begin(self, k: int) -> None:
        """Step k begins; the keys of the next one are there too, for its measurement."""
        self._step, self._following = self._following, self._shared(k + 1)

    def coin(self) -> Integers | None:
        """The candidate that a key says, or None."""
        return None if self._step.digit is None else self._step.digit[:, 0]

    def believed(self, k: int) -> Integers:
        """What she takes the coin of step k for."""
        coin = self.coin()
        if coin is None:
            return np.full(self.runs, UNKNOWN)
        if self._keys.believed is not None:
            return np.asarray(self._keys.believed[k])
        return np.where(self._keys.held, coin, UNKNOWN)

    def carry(self, k: int, x: Array, attack: BusAttack | None) -> tuple[Array, Flags]:
        """x(k) over the wire: what is read, and where that alarms.

        What an attack is shown, and what it says, she turns by the rotation that she has.
        """
        S, alarm = self._following.rotation, np.zeros(self.runs, bool)
        sent = x if S is None else turned(S, x)
        if attack is not None:
            T = self._drawn(self._hers).rotation
            if S is not None and T is not None:
                T = np.where(self._keys.held[:, None, None], S, T)
            read = sent if T is None else turned(back(T), sent)
            says = attack.toward_controller(k, read, np.ones(self.runs, bool))
            if "mac" in self._defences:
                alarm = ~self._keys.held & (says != read).any(axis=1)
            sent = says if T is None else turned(T, says)
        return (sent if S is None else turned(back(S), sent)), alarm

    def test(self, gauges: Array) -> Flags:
        """Where no candidate explains the transition that the last offer led to (equation 14).

        With a digit, where its own does not; g <= 1 to rounding.
        """
        alarm: Flags = ~(gauges.min(-1) <= INSIDE)
        if self._step.digit is not None:
            alarm |= ~(np.take_along_axis(gauges, self._step.digit, -1)[..., 0] <= INSIDE)
        return alarm


class _Draws:
    """d and private coins of one generator; the coin is drawn only where no key chooses it."""

    at_once = 1

    def __init__(
        self, scenario: Scenario, runs: int, draw: np.random.Generator, *, private: bool
    ) -> None:
        self._spec, self._n = scenario.plant.disturbance, scenario.n
        self._size, self._runs = scenario.secrecy.candidates, runs
        self._draw, self._private = draw, private

    def block(self, k: int, steps: int) -> tuple[Array, Integers]:
        """See :meth:`wyner.simulate.engine.draws.Draws.block`; one step at a time."""
        coins = np.zeros((steps, self._runs), np.int64)
        if self._private:
            coins = self._draw.integers(self._size, size=(steps, self._runs))
        return disturbances(self._spec, k, self._draw.random((steps, self._n, self._runs))), coins


class _Attacked(Between):
    """An attacker and the ends' defences between the ends; what became of each run is counted."""

    def __init__(
        self,
        scenario: Scenario,
        attack: Attack | None,
        ends: _Ends,
        onset: int,
        watermark: tuple[float, np.random.Generator],
        eye: tuple[float | None, np.random.Generator],
    ) -> None:
        self._attack, self._ends, self._onset = attack, ends, onset
        self._watermark, self._secret = watermark
        self._eye, self._hers = eye
        self._true_B = np.array(scenario.plant_model[1])
        runs = ends.runs
        self._shown = self._offers = self._candidates = np.empty(0)
        self._alarm = np.zeros(runs, bool)
        self.alarmed, self.false_alarms = np.zeros(runs, np.int64), 0
        self.away, self.largest = np.zeros(runs), np.zeros(runs)

    def offered(
        self, k: int, shown: Array, candidates: Array, coin: Integers
    ) -> tuple[Array, Integers]:
        """Step ``k`` begins; a key chooses the candidate, or a watermark stands in their place."""
        self._ends.begin(k)
        self._shown, self._offers = shown, candidates
        if self._watermark:
            self._offers = candidates.mean(axis=1, keepdims=True)
            noise = self._secret.standard_normal((len(shown), 1, candidates.shape[2]))
            candidates = np.repeat(self._offers + self._watermark * noise, candidates.shape[1], 1)
        else:
            keyed = self._ends.coin()
            coin = coin if keyed is None else keyed
        self._candidates = candidates
        return candidates, coin

    def received(self, k: int, candidates: Array) -> Array:
        """The candidates after an attack on the bus."""
        if isinstance(self._attack, BusAttack) and k >= self._onset:
            return self._attack.toward_plant(k, candidates)
        return candidates

    def applied(self, k: int, u: Array) -> Array:
        """The input after an attack on the actuator."""
        if isinstance(self._attack, ActuatorAttack):
            if k >= self._onset:
                return self._attack.actuator(u)
            self._attack.watch_input(u)
        return u

    def read(self, k: int, reading: Array, u: Array) -> Array:
        """x(k) after an attack on the sensor, the wire and one on it."""
        attack, attacked = self._attack, k >= self._onset
        if isinstance(attack, SensorAttack):
            if attacked:
                believed = self._ends.believed(k - 1)
                if self._eye is not None:
                    believed = self._nearest(u, self._eye)
                noise, seen = attack.options.sees, None
                if noise is not None:
                    seen = reading + noise * self._hers.standard_normal(reading.shape)
                reading = attack.sensor(Observation(k, self._shown, self._offers, believed, seen))
            else:
                attack.watch(reading)
        bus = attack if isinstance(attack, BusAttack) and attacked else None
        reported, self._alarm = self._ends.carry(k, reading, bus)
        return reported

    def _nearest(self, u: Array, eye: float) -> Integers:
        """The candidate whose push is nearest to what one sees who knows all but the coin."""
        seen = u @ self._true_B.T + eye * self._hers.standard_normal(self._shown.shape)
        off = self._candidates @ self._true_B.T - seen[:, None, :]
        return np.asarray((off**2).sum(-1).argmin(-1))

    def judged(self, k: int, x: Array, shown: Array, gauges: Array) -> None:
        """Count alarms, and until a run's first one how far it is away."""
        alarm = self._alarm | self._ends.test(gauges)
        if self._attack is None or k + 1 < self._onset:
            self.false_alarms += int(alarm.sum())
            return
        going = self.alarmed == 0
        largest = np.maximum(self.largest, np.linalg.norm(shown, axis=1))
        np.copyto(self.largest, largest, where=going)
        np.copyto(self.away, np.linalg.norm(x - shown, axis=1), where=going)
        self.alarmed[alarm & going] = k + 2 - self._onset


def attack_runs(
    scenario: Scenario,
    law: CandidateLaw,
    kind: Kind | None,
    defences: Sequence[str],
    keys: Keys,
    *,
    seed: Sequence[int],
    steps: int,
    onset: int = ONSET,
    watermark: float = 0.0,
    eye: float | None = None,
    start: Array | None = None,
) -> Attacked:
    """Simulate as many runs as ``keys`` speaks of: ``onset`` honest steps, then attacked ones.

    Parameters
    ----------
    scenario : Scenario
    law : CandidateLaw
    kind : callable or None
        Makes the attack; None: nobody attacks, and every step is honest.
    defences : sequence of str
        Of :data:`KEY_BITS`.
    keys : Keys
    seed : sequence of int
    steps : int
        Attacked steps; honest ones where nobody attacks.
    onset : int
        Honest steps before.
    watermark : float
        Standard deviation of a secret Gaussian watermark v + N(0, s^2), of which both ends know
        each value, in place of the candidates; 0: none.
    eye : float, optional
        She knows x(k) and d(k), sees x(k+1) through noise of this deviation, and takes the coin for
        the one that is nearest: more than any attack of the project's is told.
    start : array, shape (R, n), optional
        Initial states in place of the scenario's.

    Raises
    ------
    SimulationError
        When what is shown leaves every set, or the plant is not linear.
    """
    runs = len(keys.held)
    public, secret, hers = (np.random.default_rng([*seed, part]) for part in range(3))
    attack = None if kind is None else kind(np.random.default_rng([*seed, 3]))
    ends = _Ends(defences, scenario.secrecy.candidates, keys, secret, hers)
    between = _Attacked(scenario, attack, ends, onset, (watermark, secret), (eye, hers))
    private = not watermark and ends.coin() is None
    simulate_runs(
        scenario,
        law,
        seed=0,
        runs=range(runs),
        steps=onset + steps - 1,
        draws=_Draws(scenario, runs, public, private=private),
        start=start,
        between=between,
    )
    return Attacked(steps, between.alarmed, between.false_alarms, between.away, between.largest)
