"""Attacked runs, many at once: the attacker's own classes against the defences' own.

They stand between the ends of :func:`~wyner.simulate.engine.loop.simulate_runs`. A step is the
services': the controller offers for what it was shown, the plant applies one candidate, its reading
passes the attacker, the wire and the defences, and is tested. Steps are counted from the onset:
step 1 is the first reading that she may change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from attacker_service.base import (
    UNKNOWN,
    ActuatorAttack,
    Attack,
    BusAttack,
    Observation,
    SensorAttack,
)
from controller_service.laws.base import CandidateLaw
from protocol.arrays import Array, Counts, Flags, Integers
from protocol.scenario import Scenario
from studies.attacks.defences import Defence, Residual, Wire, Words
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


class _Ends:
    """Both ends' defences with their keys, and what she makes of these.

    A defence's key of a step serves the measurement x(k), the offer that answers it, and the test
    of what comes of that offer.
    """

    def __init__(
        self,
        defences: Sequence[Defence],
        keys: Keys,
        secret: np.random.Generator,
        hers: np.random.Generator,
    ) -> None:
        self._chain, self._keys, self._secret, self._hers = defences, keys, secret, hers
        self.runs = len(keys.held)
        self._runs = (self.runs,)
        self._session = [d.session_key(secret, self._runs) for d in defences]
        self._her_session = [
            np.where(keys.held[:, None], true, d.session_key(hers, self._runs))
            for d, true in zip(defences, self._session, strict=True)
        ]
        self._following = self._drawn(0)
        self._step = self._following

    def _drawn(self, k: int) -> list[Integers]:
        """Keys of step k."""
        given, out = self._keys.digits, []
        for d, session in zip(self._chain, self._session, strict=True):
            step = d.step_key(self._secret, self._runs)
            if given is not None and k < len(given) and d.coin(session, step) is not None:
                step = given[k][:, None]
            out.append(step)
        return out

    def begin(self, k: int) -> None:
        """Step k begins; the keys of the next one are there too, for its measurement."""
        self._step, self._following = self._following, self._drawn(k + 1)

    def coin(self) -> Integers | None:
        """The candidate that a key says, or None."""
        for d, session, step in zip(self._chain, self._session, self._step, strict=True):
            coin = d.coin(session, step)
            if coin is not None:
                return coin
        return None

    def believed(self, k: int) -> Integers:
        """What she takes the coin of step k for."""
        coin = self.coin()
        if coin is None:
            return np.full(self._runs, UNKNOWN)
        if self._keys.believed is not None:
            return np.asarray(self._keys.believed[k])
        return np.where(self._keys.held, coin, UNKNOWN)

    def carry(self, k: int, x: Array, attack: BusAttack | None) -> tuple[Array, Flags]:
        """x(k) over the wire: what is read, and where that alarms."""
        wires = []
        for i, d in enumerate(self._chain):
            wires.append(d.encode(k, self._session[i], self._following[i], x))
            x = wires[-1].values
        tags = [wire.tag for wire in wires]
        if attack is not None:
            x, tags = self._rewritten(k, x, tags, attack)
        alarm = np.zeros(self._runs, bool)
        for i in reversed(range(len(self._chain))):
            opened = self._chain[i].decode(
                k, self._session[i], self._following[i], Wire(x, tags[i])
            )
            x, alarm = opened.x, alarm | opened.alarm
        return x, alarm

    def _rewritten(
        self, k: int, sent: Array, tags: list[Words | None], attack: BusAttack
    ) -> tuple[Array, list[Words | None]]:
        """What she sends on: opened, changed and closed again under the keys that she has.

        A tag is shifted by what the change does to it under her key, so that its pad stays: under a
        guessed point that is the best forgery.
        """
        held = self._keys.held[:, None]
        steps = [
            np.where(held, true, d.step_key(self._hers, self._runs))
            for d, true in zip(self._chain, self._following, strict=True)
        ]
        opened = sent
        under: list[Array] = []
        for i in reversed(range(len(self._chain))):
            wire = Wire(opened, tags[i])
            opened = self._chain[i].decode(k, self._her_session[i], steps[i], wire).x
            under.insert(0, opened)
        x = attack.toward_controller(k, opened, np.ones(self._runs, bool))
        out: list[Words | None] = []
        for i, d in enumerate(self._chain):
            wire, tag = d.encode(k, self._her_session[i], steps[i], x), tags[i]
            if tag is not None and wire.tag is not None:
                before = d.encode(k, self._her_session[i], steps[i], under[i]).tag
                assert before is not None
                tag = tag ^ before ^ wire.tag
            out.append(tag)
            x = wire.values
        return x, out

    def test(self, gauges: Array) -> Flags:
        """Where the transition that the last offer led to alarms."""
        alarm = np.zeros(self._runs, bool)
        for d, session, step in zip(self._chain, self._session, self._step, strict=True):
            alarm |= d.alarm(session, step, gauges)
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
    defences: Sequence[Defence],
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
    defences : sequence of Defence
        Besides the residual test, which is always on; one of them may key the coin.
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
    runs, size = len(keys.held), scenario.secrecy.candidates
    public, secret, hers = (np.random.default_rng([*seed, part]) for part in range(3))
    attack = None if kind is None else kind(np.random.default_rng([*seed, 3]))
    ends = _Ends((Residual(scenario.n, size), *defences), keys, secret, hers)
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
