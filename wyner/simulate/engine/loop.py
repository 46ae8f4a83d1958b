"""Plant, laws and the agreement test's gauges for many runs, step by step.

Two strategies share one loop. :class:`_Many` steps linear plants together, elementwise and in the
order of :func:`protocol.agreement.predict` and :class:`protocol.agreement.Gauge`: products added
from the left, then the disturbance. No BLAS and no einsum, which may fuse multiply and add. For a
single input every number is therefore the services' own to the last bit. :class:`_One` steps one
run of any plant, through the very objects that the services step.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from controller_service.laws.errors import OutsideError, ProgramError
from plant_service.adapters import Operated, PlantError
from plant_service.adapters.registry import NOISE_OF_ITS_OWN, is_model, open_plant
from plant_service.plant import (
    Disturbances,
    FilteredPlant,
    LinearModel,
    OperatedPlant,
    sensed,
)
from plant_service.plant import Plant as SteppedPlant
from protocol.agreement import INSIDE, NO_SYMBOL, Gauge, predict, spread
from protocol.arrays import Array, Flags, Indices, Symbols
from protocol.box_observer import Box, Estimate
from protocol.brief import Brief
from protocol.errors import WynerError
from protocol.link.fallback import Fallback
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from protocol.streams import COIN, DISTURBANCE, SENSOR, Stream
from protocol.vectors import Vector
from runtime.errors import Failure
from runtime.user_code import load_model
from wyner.simulate.engine.draws import Draws, SeededDraws, Streams, symbol_type
from wyner.simulate.missed import missed_steps

CHUNK_RUNS: Final = 4096
"""Runs simulated together: a column (32 kB) stays in cache, and NumPy's calls are paid for."""

Places = NDArray[np.intp]


class SimulationError(WynerError):
    """A run that cannot go on; the message names run, step and reason."""


class Law(Protocol):
    """What one run at a time needs of a control law."""

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The M candidate inputs at ``x``."""


class ManyLaw(Law, Protocol):
    """What runs together need of one; every :class:`CandidateLaw` is both."""

    def indices(self, X: Array, /) -> Indices:
        """i(k) of each row of X, shape (R, n)."""

    def candidates_many(self, X: Array, indices: Indices | None = None, /) -> Array:
        """The candidates of each row, shape (R, M, m)."""


class Between:
    """What stands between the ends of runs together, and what watches them: nothing, here.

    Attacks, defences and studies extend it. The axes of arrays are R, then n or M and m.
    """

    def offered(
        self,
        k: int,  # noqa: ARG002
        shown: Array,  # noqa: ARG002
        candidates: Array,
        coin: Symbols,
    ) -> tuple[Array, Symbols]:
        """The candidates that both ends reckon with, and the one that the plant takes."""
        return candidates, coin

    def received(self, k: int, candidates: Array) -> Array:  # noqa: ARG002
        """The candidates as they reach the plant."""
        return candidates

    def applied(self, k: int, u: Array) -> Array:  # noqa: ARG002
        """The input as it reaches the plant, shape (R, m)."""
        return u

    def read(self, k: int, reading: Array, u: Array) -> Array:  # noqa: ARG002
        """The reading of step ``k``, after ``u``, as it reaches the controller; shape (R, n)."""
        return reading

    def judged(self, k: int, x: Array, shown: Array, gauges: Array) -> None:
        """Step ``k`` has been tested: x(k+1), as it was shown, and g of each candidate, (R, M)."""

    def settled(self, k: int, symbol: Symbols, largest: Array) -> None:
        """What :class:`Runs` keeps of step ``k``, shape (R,)."""


@dataclass(frozen=True, eq=False, repr=False)
class Runs(Brief):
    """What a simulation keeps of every transition; time is the first axis, runs the last.

    Parameters
    ----------
    scenario : Scenario
    seed : int
    runs : range
        Numbers of the runs.
    coin : integer array, shape (steps, R)
        b_r.
    symbol : integer array, shape (steps, R)
        The one candidate whose gauge is at most 1, or -1 where there is none or more than one;
        the likeliest candidate where d is taken to be Gaussian.
    largest : array, shape (steps, R)
        The largest gauge, of D_e over alpha: a transition is in Diff at alpha when ``symbol`` is
        not -1 and this is at most alpha.
    state_cost, input_effort : array, shape (R,)
        Sums over steps of abs(x(k+1))^2 and abs(u(k))^2.
    cost : array, shape (R,)
        Sum over steps of x(k+1)' Q x(k+1) + u(k)' R u(k), the scenario's ``cost_weights``.
    missed : bool array, shape (steps, R), optional
        Steps without an offer, where the scenario has a network: no transitions, their ``coin`` and
        ``symbol`` are -1.
    x : array, shape (steps + 1, n or readings, R), optional
        States as they are read, y where sensors are noisy; with ``candidates`` and ``gauges`` only
        where the record was asked for.
    candidates : array, shape (steps, M, m, R), optional
    gauges : array, shape (steps, M, R), optional
    u : array, shape (steps, m, R), optional
        What was chosen, to be applied.
    truth : array, shape (steps + 1, n, R), optional
        The states themselves, where sensors are noisy.
    """

    scenario: Scenario
    seed: int
    runs: range
    coin: Symbols
    symbol: Symbols
    largest: Array
    state_cost: Array
    input_effort: Array
    cost: Array
    missed: NDArray[np.bool_] | None = None
    x: Array | None = None
    candidates: Array | None = None
    gauges: Array | None = None
    u: Array | None = None
    truth: Array | None = None

    def brief(self) -> dict[str, object]:
        """Of which system, and how many."""
        return {
            "scenario": self.scenario.name,
            "runs": len(self.runs),
            "steps": self.steps,
            "seed": self.seed,
            "recorded": self.x is not None,
        }

    @property
    def steps(self) -> int:
        """Steps of each run."""
        return len(self.coin)

    @property
    def missed_share(self) -> Array:
        """The share of missed steps of each run, shape (R,)."""
        if self.missed is None:
            return np.zeros(len(self.runs))
        out: Array = self.missed.mean(axis=0)
        return out

    @property
    def mean_cost(self) -> Array:
        """The control cost a step of each run, shape (R,)."""
        return self.cost / self.steps


def _beside(parts: Sequence[Runs], runs: range) -> Runs:
    """Runs that were made one by one, as if together."""
    first = parts[0]
    arrays = {f.name for f in fields(first) if isinstance(getattr(first, f.name), np.ndarray)}
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in arrays
    }
    return replace(first, runs=runs, **joined)


def _weighted(row: Sequence[float], columns: Sequence[Array], out: Array, spare: Array) -> None:
    """row[0] columns[0] + row[1] columns[1] + ..., added from the left, into ``out``."""
    np.multiply(columns[0], row[0], out=out)
    for weight, column in zip(row[1:], columns[1:], strict=True):
        np.multiply(column, weight, out=spare)
        np.add(out, spare, out=out)


def _add(row: Sequence[float], columns: Sequence[Array], out: Array, spare: Array) -> None:
    """``out`` + row[0] columns[0] + ..., added from the left."""
    for weight, column in zip(row, columns, strict=True):
        np.multiply(column, weight, out=spare)
        np.add(out, spare, out=out)


class _Loop:
    """What both strategies have: the runs' states, what was read of them, and the last verdict."""

    x: Array
    """x, shape (n, R)."""
    y: Array
    """As it is read, shape (n or readings, R)."""

    def __init__(self, scenario: Scenario, runs: range) -> None:
        self.scenario, self.runs = scenario, runs
        self.n, self.m, self.M = scenario.n, scenario.m, scenario.secrecy.candidates
        rules = rules_of(scenario)
        self.rules, self.rule, self.noise = rules, rules.agreement, scenario.plant.noise
        self.fallback = Fallback.of(scenario).input
        R = len(runs)
        self.gauges = np.empty((self.M, R))
        self.u = np.zeros((self.m, R))
        own = scenario.secrecy.disturbance is not None or self.rule.apart is not None
        self.possible = np.empty((self.M, R)) if own or rules.outputs else self.gauges
        self._inside = np.empty((self.M, R), dtype=bool)
        self.unlikeliness = np.zeros((self.M, R))

    def verdict(self, symbol: Symbols, largest: Array) -> None:
        """The verdict's parts that do not depend on alpha."""
        if self.rule.deviations is not None:
            symbol[:], largest[:] = np.argmin(self.unlikeliness, axis=0), 0.0
            return
        np.less_equal(self.gauges, INSIDE, out=self._inside)
        if self.M == 2:
            np.maximum(self.possible[0], self.possible[1], out=largest)
            # One inside only: its index is the second's flag; otherwise -1.
            np.copyto(symbol, self._inside[1].view(np.int8))
            np.copyto(symbol, NO_SYMBOL, where=self._inside[0] == self._inside[1])
            return
        np.max(self.possible, axis=0, out=largest)
        symbol[:] = np.argmax(self._inside, axis=0)
        np.copyto(symbol, NO_SYMBOL, where=self._inside.sum(axis=0) != 1)

    def close(self) -> None:
        """Close what is open."""


class _Many(_Loop):
    """Linear plants whose states are read, all runs together."""

    def __init__(
        self,
        scenario: Scenario,
        law: ManyLaw,
        runs: range,
        seed: int,
        draws: Draws | None,
        start: Array | None,
        between: Between | None,
    ) -> None:
        super().__init__(scenario, runs)
        self.law, self.between = law, between
        plant = scenario.plant
        if not steps_together(scenario):
            raise SimulationError(
                f"plant.kind: got {plant.kind!r}, expected 'linear' with a disturbance of the "
                "state: the engine steps nothing else together"
            )
        self.A, self.B = scenario.A, scenario.B
        self.true_A, self.true_B = scenario.plant_model
        self.same_model = (self.true_A, self.true_B) == (self.A, self.B)
        self.gauge = Gauge.from_rows(*scenario.test_set.rows())
        hers = scenario.secrecy.disturbance
        self.reach = None if hers is None else Gauge.from_rows(*hers.rows())
        self.draws = draws or SeededDraws(scenario, seed, runs)
        R = len(runs)
        first = np.array(scenario.initial_state) if start is None else start
        self.x = np.broadcast_to(first, (R, self.n)).T.copy(order="C")
        self.y = self.x
        if self.noise is not None:
            self.sensors = Streams(seed, runs, SENSOR)
            self.y = self.x + self.drawn()
            self.x = self.y - self.last
        self.following = np.empty((self.n, R))
        self.free = np.empty((self.n, R))  # A x
        self.predictions = np.empty((self.M, self.n, R))
        self.difference = np.empty((self.n, R))
        self.spare = np.empty(R)
        self.ratio = np.empty(R)
        self.d = np.empty((0, self.n, R))
        self.first = 0

    @property
    def at_once(self) -> int:
        """Steps for which random numbers are drawn at a time."""
        return self.draws.at_once

    def tosses(self, k: int, steps: int) -> Symbols:
        """The coins of so many steps from ``k`` on, shape (steps, R); d of them is drawn too."""
        self.first, (self.d, coins) = k, self.draws.block(k, steps)
        return coins

    def offers(self, k: int, missed: Flags | None) -> Array:
        """The candidates of step ``k``; who is in no set misses it, where a step may be missed."""
        X = self.y.T
        if missed is not None:
            missed[k] |= self._outside(X)
            X = np.where(missed[k][:, None], 0.0, X)
        try:
            return self.law.candidates_many(X, self.law.indices(X))
        except (OutsideError, ProgramError) as error:
            last = self.runs.stop - 1
            raise SimulationError(f"runs {self.runs.start} to {last}, step {k}: {error}") from None

    def _outside(self, X: Array) -> Flags:
        """Which rows of X lie in no set, or have no answer: there the controller offers nothing."""
        out = np.zeros(len(X), dtype=bool)
        try:
            self.law.candidates_many(X, self.law.indices(X))
        except (OutsideError, ProgramError):
            for r, x in enumerate(X.tolist()):
                try:
                    self.law.candidates(tuple(x))
                except LookupError:
                    out[r] = True
        return out

    def choose(self, coin: Symbols, options: Sequence[Array], out: Array) -> None:
        """``out`` = options[coin], run by run."""
        np.copyto(out, options[0])
        for i in range(1, self.M):
            np.copyto(out, options[i], where=coin == i)

    def _columns(self, candidates: Array) -> list[list[Array]]:
        """The candidates' columns, ``columns[i][j]`` of shape (R,)."""
        return [
            [np.ascontiguousarray(candidates[:, i, j]) for j in range(self.m)]
            for i in range(self.M)
        ]

    def step(self, k: int, candidates: Array, coin: Symbols, missed: Places) -> None:
        """Centres, next state and gauges; of the runs ``missed`` the fallback is applied."""
        columns, between = self._columns(candidates), self.between
        got = columns if between is None else self._columns(between.received(k, candidates))
        rows_x, rows_y, d = list(self.x), list(self.y), self.d[k - self.first]
        instead = [
            self.fallback(tuple(y), tuple(u))
            for y, u in zip(self.y[:, missed].T.tolist(), self.u[:, missed].T.tolist(), strict=True)
        ]
        for i in range(self.n):
            _weighted(self.A[i], rows_y, self.free[i], self.spare)
        for j, inputs in enumerate(columns):
            for i in range(self.n):
                np.copyto(self.predictions[j, i], self.free[i])
                _add(self.B[i], inputs, self.predictions[j, i], self.spare)
        for i in range(self.m):
            self.choose(coin, [inputs[i] for inputs in got], self.u[i])
        if between is not None:
            self.u[:] = between.applied(k, self.u.T.copy()).T
        for i in range(self.n):
            out = self.following[i]
            if self.same_model and self.noise is None and between is None:
                self.choose(coin, [self.predictions[j, i] for j in range(self.M)], out)
            else:
                _weighted(self.true_A[i], rows_x, out, self.spare)
                _add(self.true_B[i], list(self.u), out, self.spare)
            np.add(out, d[i], out=out)
        for r, u in zip(missed.tolist(), instead, strict=True):
            self.u[:, r] = u
            moved = predict(self.true_A, self.true_B, self.x[:, r].tolist(), u)
            self.following[:, r] = np.array(moved) + d[:, r]
        self.x, self.following = self.following, self.x
        self.y = self.x
        if self.noise is not None:  # the state is what the reading is without its noise
            self.y = self.x + self.drawn()
            self.x = self.y - self.last
        if between is not None:
            read = between.read(k + 1, self.y.T.copy(), self.u.T)
            self.y = np.ascontiguousarray(read.T)
        for j in range(self.M):
            np.subtract(self.y, self.predictions[j], out=self.difference)
            if self.rule.deviations is not None:
                self.unlikeliness[j] = 0.0
                for v, s in zip(self.difference, self.rule.deviations, strict=True):
                    np.divide(v, s, out=self.ratio)
                    np.multiply(self.ratio, self.ratio, out=self.ratio)
                    np.add(self.unlikeliness[j], self.ratio, out=self.unlikeliness[j])
            self.measure(self.gauge, self.gauges[j])
            if self.reach is not None:
                np.subtract(self.y, self.predictions[j], out=self.difference)
                self.measure(self.reach, self.possible[j])
        if self.rule.apart is not None:
            self.measure_spread(self.rule.apart)

    def drawn(self) -> Array:
        """n of the next readings, shape (n, R)."""
        assert self.noise is not None
        uniforms = self.sensors.take(self.scenario.readings).T
        drawn: Array
        if self.noise.half_widths is None:
            corners = np.array(self.noise.corners())
            drawn = corners[(uniforms[0] * len(corners)).astype(np.intp)].T
        else:
            w = np.array(self.noise.half_widths)[:, None]
            box = self.noise.kind == "corners"
            drawn = np.where(uniforms >= 0.5, w, -w) if box else (2.0 * uniforms - 1.0) * w
        self.last = drawn
        return drawn

    def measure_spread(self, gauge: Gauge) -> None:
        """How far the candidates' predictions lie apart, the same for each candidate."""
        widest = np.zeros(len(self.runs))
        for j in range(self.M):
            for i in range(self.M):
                np.subtract(self.predictions[j], self.predictions[i], out=self.difference)
                self.measure(gauge, self.possible[0])
                np.maximum(widest, self.possible[0], out=widest)
        self.possible[:] = 1.0 + widest

    def measure(self, gauge: Gauge, out: Array) -> None:
        """``out`` = g(difference)."""
        widths = gauge.half_widths
        v = self.difference
        if widths is not None:
            np.abs(v, out=v)
            np.divide(v[0], widths[0], out=out)
            for i in range(1, self.n):
                np.divide(v[i], widths[i], out=self.ratio)
                np.maximum(out, self.ratio, out=out)
            return
        out[:] = 0.0
        for row, bound in zip(gauge.H, gauge.h, strict=True):
            _weighted(row, list(v), self.ratio, self.spare)
            np.divide(self.ratio, bound, out=self.ratio)
            np.maximum(out, self.ratio, out=out)


class _One(_Loop):
    """One run of any plant, by what the services step: their plants, boxes and verdicts."""

    at_once = SeededDraws.at_once

    def __init__(
        self,
        scenario: Scenario,
        law: Law,
        run: int,
        seed: int,
        opened: Callable[[], Operated] | None,
        folder: Path,
    ) -> None:
        super().__init__(scenario, range(run, run + 1))
        self.law, self.predict = law, load_model(scenario, folder)
        self.coins = Streams(seed, self.runs, COIN)
        spec, outputs = scenario.plant.disturbance, self.rules.outputs
        draws = Stream(seed, DISTURBANCE, width=len(spec.half_widths), run=run)
        sensors = Stream(seed, SENSOR, width=scenario.readings, run=run)
        disturbances, x = Disturbances(scenario, draws), scenario.initial_state
        self.plant: SteppedPlant
        if opened is None and is_model(scenario):
            self.plant = LinearModel(scenario, disturbances)
        else:
            operated = open_plant(scenario, folder) if opened is None else opened()
            enters = spec.enters or "state"
            self.plant = OperatedPlant(operated, disturbances, enters)
        try:
            if outputs is not None and self.plant.device:
                text = "plant.C: expected none of a device here, as its states are not known; the "
                raise SimulationError(f"{text}two ends and wyner up run it")
            if self.noise is not None and self.plant.device:
                raise SimulationError(NOISE_OF_ITS_OWN)
            if isinstance(self.plant, OperatedPlant):
                x = self.plant.operated.start(seed + run)
        except (SimulationError, PlantError) as error:
            self.plant.close()
            told = f"run {run}, step 0: {error}" if isinstance(error, PlantError) else str(error)
            raise SimulationError(told) from None
        self.plant, first = sensed(self.plant, scenario, None, sensors, x, None, None)
        self.now = x if first is None else first
        self._look()
        self.box: Box | None = None
        self.estimate: Estimate | None = None
        self.gone = 0  # missed steps since the last transition
        self.offer: tuple[Vector, ...] = ()
        self.centres: tuple[Vector, ...] = ()

    def tosses(self, k: int, steps: int) -> Symbols:  # noqa: ARG002
        """The coins of so many steps from ``k`` on, shape (steps, 1)."""
        return (self.coins.take(steps).T * self.M).astype(symbol_type(self.M))

    def offers(self, k: int, missed: Flags | None) -> Array:
        """The candidates of step ``k``; in no set it is missed, where a step may be missed."""
        nothing = np.full((1, self.M, self.m), np.nan)
        if missed is not None and missed[k, 0]:
            return nothing
        outputs, about = self.rules.outputs, self.now
        if outputs is not None:
            self.box = outputs.box(self.estimate, self.gone, self.now)
            about = self.box.centre
        try:
            self.offer = self.law.candidates(about)
            if self.predict is not None:
                self.centres = tuple([self.predict(about, u) for u in self.offer])
        except LookupError as error:
            if missed is None:
                raise self._stopped(k, error) from None
            missed[k] = True
            return nothing
        return np.array(self.offer)[None]

    def step(self, k: int, candidates: Array, coin: Symbols, missed: Places) -> None:  # noqa: ARG002
        """The plant moves, and the transition is judged, unless it is missed."""
        outputs, y = self.rules.outputs, self.now
        u: Vector = tuple(self.u[:, 0].tolist())
        if not len(missed):
            u = self.offer[int(coin[0])]
        elif outputs is None:
            u = self.fallback(y, u)
        else:
            u = outputs.instead(self.estimate, self.gone, u)
        try:
            self.plant.begin(k, y, u)
            self.now = self.plant.end(k)
        except (PlantError, Failure) as error:
            raise self._stopped(k, error) from None
        self.u[:, 0] = u
        self._look()
        if len(missed):
            self.gone += 1
            return
        self.gone = 0
        found = self.rules.judge(y, self.offer, self.centres, self.now, self.box)
        self.estimate, self.gauges[:, 0] = found.estimate, found.gauges
        self.unlikeliness[:, 0] = np.arange(self.M) != found.symbol  # asked where there is one
        if self.possible is self.gauges:
            return
        if outputs is not None:
            assert self.box is not None
            apart, centres = outputs.apart, outputs.predictions(self.box, self.offer)
            self.possible[:] = 1.0 + spread(apart, centres)
            return
        s = self.scenario
        at = self.centres or [predict(s.A, s.B, y, option) for option in self.offer]
        self.possible[:] = self.rule.widest(at, self.now)

    def _look(self) -> None:
        """Where the plant is, and what is read of it."""
        behind = self.plant
        self.x = _column(behind.x if isinstance(behind, FilteredPlant) else self.now)
        self.y = _column(self.now)

    def _stopped(self, k: int, error: Exception) -> SimulationError:
        return SimulationError(f"run {self.runs.start}, step {k}: {error}")

    def close(self) -> None:
        """Close the plant."""
        self.plant.close()


def _column(v: Vector) -> Array:
    return np.array(v)[:, None]


def steps_together(scenario: Scenario) -> bool:
    """Whether runs can be stepped together: a linear plant and f_c, and states that are read."""
    plant = scenario.plant
    return (
        plant.kind == "linear"
        and plant.C is None
        and plant.disturbance.enters in (None, "state")
        and scenario.defender.model is None
    )


def simulate_runs(
    scenario: Scenario,
    law: Law,
    *,
    seed: int,
    runs: range,
    steps: int,
    record: bool = False,
    folder: Path = Path(),
    plant: Callable[[], Operated] | None = None,
    draws: Draws | None = None,
    start: Array | None = None,
    between: Between | None = None,
) -> Runs:
    """Simulate ``runs``: together where :func:`steps_together`, one by one where not.

    Parameters
    ----------
    scenario : Scenario
        Its plant, disturbance and agreement rule; the law is the one given.
    law : Law
        One that answers many states at once, for runs together.
    seed : int
    runs : range
        Numbers of the runs, each with its own streams.
    steps : int
    record : bool
        Keep states, candidates, inputs and gauges of every step.
    folder : Path
        Where the files that the scenario names are looked for.
    plant : callable, optional
        Opens a plant of one's own for each run, in place of the scenario's; it is closed when the
        run ends.
    draws, start, between : optional
        For runs together: what is drawn in place of the seed's streams, initial states, shape
        (R, n), and who stands between the ends.

    Raises
    ------
    SimulationError
        When a state leaves every set, or a program has no answer; with a network that is a missed
        step. Also when a plant fails.
    """
    if len(runs) < 1 or steps < 1:
        got = f"got {len(runs)} and {steps}"
        raise ValueError(f"runs and steps: {got}, expected at least one of each")
    asked = draws is not None or start is not None or between is not None
    loop: _Many | _One
    if asked or (plant is None and steps_together(scenario)):
        loop = _Many(scenario, law, runs, seed, draws, start, between)  # type: ignore[arg-type]
        missed = missed_steps(scenario, seed=seed, runs=runs, steps=steps)
        return _simulated(loop, seed, steps, missed, record=record, between=between)
    parts = []
    for run in runs:
        one = range(run, run + 1)
        missed = missed_steps(scenario, seed=seed, runs=one, steps=steps)
        with closing(_One(scenario, law, run, seed, plant, folder)) as loop:
            parts.append(_simulated(loop, seed, steps, missed, record=record))
    return _beside(parts, runs)


def _simulated(
    loop: _Many | _One,
    seed: int,
    steps: int,
    missed: Flags | None,
    *,
    record: bool,
    between: Between | None = None,
) -> Runs:
    """The loop itself: offer, toss, move, judge; what is kept of every step."""
    scenario, M, m, n, R = loop.scenario, loop.M, loop.m, loop.n, len(loop.runs)
    tosses = np.empty((steps, R), dtype=symbol_type(M))
    coin = np.empty_like(tosses) if missed is not None else tosses
    symbol = np.empty((steps, R), dtype=symbol_type(M))
    largest = np.empty((steps, R))
    state_cost, input_effort, cost, spare = np.zeros(R), np.zeros(R), np.zeros(R), np.empty(R)
    Q, weight = scenario.cost_weights
    made = np.zeros(R, dtype=np.intp)  # transitions so far
    everyone = np.arange(R)
    nobody = everyone[:0]
    kept: dict[str, Array] = {}
    if record:
        kept = {
            "x": np.empty((steps + 1, *loop.y.shape)),
            "candidates": np.empty((steps, M, m, R)),
            "gauges": np.empty((steps, M, R)),
            "u": np.empty((steps, m, R)),
        }
        kept["x"][0] = loop.y
        if loop.noise is not None or loop.rules.outputs is not None:
            kept["truth"] = np.empty((steps + 1, n, R))
            kept["truth"][0] = loop.x
    for k in range(steps):
        if k % loop.at_once == 0:
            count = min(loop.at_once, steps - k)
            tosses[k : k + count] = loop.tosses(k, count)
        candidates = loop.offers(k, missed)
        tossed, without = tosses[k], nobody
        if missed is not None:  # draw j belongs to transition j
            tossed, without = tosses[made, everyone], np.flatnonzero(missed[k])
            coin[k] = np.where(missed[k], NO_SYMBOL, tossed)
            made += ~missed[k]
        if between is not None:
            candidates, tossed = between.offered(k, loop.y.T.copy(), candidates, tossed)
            coin[k] = tossed
        loop.step(k, candidates, tossed, without)
        loop.verdict(symbol[k], largest[k])
        symbol[k, without], largest[k, without] = NO_SYMBOL, np.inf
        for i in range(n):
            np.multiply(loop.x[i], loop.x[i], out=spare)
            np.add(state_cost, spare, out=state_cost)
            cost += Q[i] * spare
        for i in range(m):
            np.multiply(loop.u[i], loop.u[i], out=spare)
            np.add(input_effort, spare, out=input_effort)
            cost += weight[i] * spare
        if between is not None:
            between.judged(k, loop.x.T, loop.y.T, loop.gauges.T)
            between.settled(k, symbol[k], largest[k])
        if kept:
            kept["x"][k + 1], kept["candidates"][k] = loop.y, candidates.transpose(1, 2, 0)
            kept["gauges"][k], kept["u"][k] = loop.gauges, loop.u
            if "truth" in kept:
                kept["truth"][k + 1] = loop.x
            kept["candidates"][k][..., without] = kept["gauges"][k][:, without] = np.nan
    return Runs(
        scenario=scenario,
        seed=seed,
        runs=loop.runs,
        coin=coin,
        symbol=symbol,
        largest=largest,
        state_cost=state_cost,
        input_effort=input_effort,
        cost=cost,
        missed=missed,
        **kept,
    )


def chunks(
    scenario: Scenario,
    law: Law,
    *,
    seed: int,
    runs: range,
    steps: int,
    chunk: int = CHUNK_RUNS,
    folder: Path = Path(),
) -> Iterator[Runs]:
    """Simulate any number of runs, ``chunk`` at a time."""
    for first in range(runs.start, runs.stop, chunk):
        part = range(first, min(first + chunk, runs.stop))
        yield simulate_runs(scenario, law, seed=seed, runs=part, steps=steps, folder=folder)
