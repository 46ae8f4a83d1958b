"""Plant, laws and the agreement test's gauges for many runs, step by step.

Arithmetic is elementwise and in the order of :func:`protocol.agreement.predict` and
:class:`protocol.agreement.Gauge`: products added from the left, then the disturbance. No BLAS and
no einsum, which may fuse multiply and add. For a single input every number is therefore the
services' own to the last bit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from controller_service.laws.base import CandidateLaw
from controller_service.laws.online import OutsideError, ProgramError
from protocol.agreement import INSIDE, NO_SYMBOL, Gauge, predict, spread
from protocol.arrays import Array, Symbols
from protocol.box_observer import Estimate
from protocol.brief import Brief
from protocol.link.fallback import Fallback
from protocol.link.outputs import OutputRule
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from protocol.streams import SENSOR
from protocol.vectors import Matrix
from wyner.simulate.engine.draws import Draws, Streams, disturbances, symbol_type
from wyner.simulate.missed import missed_steps

CHUNK_RUNS: Final = 4096
"""Runs simulated together: a column (32 kB) stays in cache, and NumPy's calls are paid for."""

BLOCK: Final = 256
"""Steps for which random numbers are drawn at a time."""


class SimulationError(Exception):
    """A run that cannot go on; the message names run, step and reason."""


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
        The one candidate whose gauge is at most 1, or -1 where there is none or more than one.
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
        What was applied.
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
    """Buffers and constants of one chunk."""

    def __init__(self, scenario: Scenario, law: CandidateLaw, runs: range, seed: int) -> None:
        self.scenario, self.law, self.runs = scenario, law, runs
        self.n, self.m, self.M = scenario.n, scenario.m, scenario.secrecy.candidates
        self.A, self.B = scenario.A, scenario.B
        plant = scenario.plant
        if plant.kind != "linear" or plant.disturbance.enters not in (None, "state"):
            raise SimulationError(
                f"plant.kind: got {plant.kind!r}, expected 'linear' with a disturbance of the "
                "state: the engine steps nothing else"
            )
        if scenario.defender.model is not None:
            raise SimulationError("defender.model: expected none, as the engine's f_c is linear")
        self.true_A: Matrix
        self.true_B: Matrix
        self.true_A, self.true_B = scenario.plant_model
        self.same_model = (self.true_A, self.true_B) == (self.A, self.B)
        self.gauge = Gauge.from_rows(*scenario.test_set.rows())
        self.rule = rules_of(scenario).agreement
        self.noise = plant.noise
        self.sensors = Streams(seed, runs, SENSOR)
        hers = scenario.secrecy.disturbance
        self.reach = None if hers is None else Gauge.from_rows(*hers.rows())
        self.possible = np.empty((self.M, len(runs)))
        self.draws = Draws(seed, runs, self.n)
        R = len(runs)
        self.x = np.repeat(np.array(scenario.initial_state)[:, None], R, axis=1)
        self.y = self.x  # as read: the state itself where sensors are exact
        self.outputs = rules_of(scenario).outputs
        if self.outputs is not None:
            self._begin_outputs(self.outputs)
        elif self.noise is not None:
            self.y = self.x + self.drawn()
            self.x = self.y - self.last
        self.following = np.empty((self.n, R))
        self.free = np.empty((self.n, R))  # A x
        self.predictions = np.empty((self.M, self.n, R))
        self.gauges = np.empty((self.M, R))
        self.u = np.zeros((self.m, R))
        self.fallback = Fallback.of(scenario).input
        self.difference = np.empty((self.n, R))
        self.spare = np.empty(R)
        self.ratio = np.empty(R)
        self.inside = np.empty((self.M, R), dtype=bool)

    def _begin_outputs(self, rule: OutputRule) -> None:
        """Where outputs alone are read each run has a box of its own, from its first reading on."""
        noise = self.drawn()
        read = np.array([rule.observer.read(x) for x in self.x.T.tolist()]).T
        self.y = read + noise
        self.estimates: list[Estimate | None] = [None] * len(self.runs)
        self.gone = [0] * len(self.runs)  # missed steps since the last transition
        self.boxes = [rule.box(None, 0, tuple(y)) for y in self.y.T.tolist()]

    @property
    def states(self) -> Array:
        """The states that the law is asked about, shape (R, n)."""
        if self.outputs is None:
            return self.y.T
        return np.array([box.centre for box in self.boxes])

    def _step_outputs(
        self,
        rule: OutputRule,
        columns: list[list[Array]],
        coin: Symbols,
        d: Array,
        missed: NDArray[np.intp],
    ) -> None:
        """The same as :meth:`step`, run by run: the box observer is the ends' own."""
        without, noise = set(missed.tolist()), self.drawn()
        read = np.empty_like(self.y)
        for r in range(len(self.runs)):
            offered = tuple([tuple([float(c[r]) for c in inputs]) for inputs in columns])
            u = offered[coin[r]]
            if r in without:
                u = rule.instead(self.estimates[r], self.gone[r], tuple(self.u[:, r].tolist()))
            moved = predict(self.true_A, self.true_B, self.x[:, r].tolist(), u)
            self.u[:, r] = u
            self.x[:, r] = np.array(moved) + d[:, r]
            read[:, r] = np.array(rule.observer.read(self.x[:, r].tolist())) + noise[:, r]
            y = tuple(read[:, r].tolist())
            if r in without:
                self.gone[r] += 1
            else:
                verdict = rule.judge(self.boxes[r], offered, y)
                self.gauges[:, r] = verdict.gauges
                predictions = rule.predictions(self.boxes[r], offered)
                self.possible[:, r] = 1.0 + spread(rule.apart, predictions)
                self.estimates[r], self.gone[r] = verdict.estimate, 0
            self.boxes[r] = rule.box(self.estimates[r], self.gone[r], y)
        self.y = read

    def choose(self, coin: Symbols, options: Sequence[Array], out: Array) -> None:
        """``out`` = options[coin], run by run."""
        np.copyto(out, options[0])
        for i in range(1, self.M):
            np.copyto(out, options[i], where=coin == i)

    def step(
        self, columns: list[list[Array]], coin: Symbols, d: Array, missed: NDArray[np.intp]
    ) -> None:
        """Centres, next state and gauges from the candidates' columns, ``columns[i][j]`` (R,).

        Of the runs ``missed`` the fallback is applied.
        """
        if self.outputs is not None:
            self._step_outputs(self.outputs, columns, coin, d, missed)
            return
        rows_x, rows_y = list(self.x), list(self.y)
        in_force = self.u[:, missed].T.tolist()
        instead = [
            self.fallback(tuple(y), tuple(u))
            for y, u in zip(self.y[:, missed].T.tolist(), in_force, strict=True)
        ]
        for i in range(self.n):
            _weighted(self.A[i], rows_y, self.free[i], self.spare)
        for j, inputs in enumerate(columns):
            for i in range(self.n):
                np.copyto(self.predictions[j, i], self.free[i])
                _add(self.B[i], inputs, self.predictions[j, i], self.spare)
        for i in range(self.m):
            self.choose(coin, [inputs[i] for inputs in columns], self.u[i])
        for i in range(self.n):
            out = self.following[i]
            if self.same_model and self.noise is None:
                self.choose(coin, [self.predictions[j, i] for j in range(self.M)], out)
            else:
                _weighted(self.true_A[i], rows_x, out, self.spare)
                _add(self.true_B[i], list(self.u), out, self.spare)
            np.add(out, d[i], out=out)
        for r, u in zip(missed.tolist(), instead, strict=True):
            self.u[:, r] = u
            moved = predict(self.true_A, self.true_B, self.x[:, r].tolist(), u)
            self.following[:, r] = np.array(moved) + d[:, r]
        read = self.following if self.noise is None else self.following + self.drawn()
        for j in range(self.M):
            np.subtract(read, self.predictions[j], out=self.difference)
            self.measure(self.gauge, self.gauges[j])
            if self.reach is not None:
                np.subtract(read, self.predictions[j], out=self.difference)
                self.measure(self.reach, self.possible[j])
        if self.rule.apart is not None:
            self.measure_spread(self.rule.apart)
        if self.noise is not None:  # the state is what the reading is without its noise
            self.y, self.x = read, read - self.last
            return
        self.x, self.following = self.following, self.x
        self.y = self.x

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

    def verdict(self, symbol: Symbols, largest: Array) -> None:
        """The verdict's parts that do not depend on alpha."""
        own = self.reach is None and self.rule.apart is None
        hers = self.gauges if own else self.possible
        np.less_equal(self.gauges, INSIDE, out=self.inside)
        if self.M == 2:
            np.maximum(hers[0], hers[1], out=largest)
            # One inside only: its index is the second's flag; otherwise -1.
            np.copyto(symbol, self.inside[1].view(np.int8))
            np.copyto(symbol, NO_SYMBOL, where=self.inside[0] == self.inside[1])
            return
        np.max(hers, axis=0, out=largest)
        symbol[:] = np.argmax(self.inside, axis=0)
        np.copyto(symbol, NO_SYMBOL, where=self.inside.sum(axis=0) != 1)


def simulate_runs(
    scenario: Scenario,
    law: CandidateLaw,
    *,
    seed: int,
    runs: range,
    steps: int,
    record: bool = False,
    folder: Path = Path(),
) -> Runs:
    """Simulate ``runs`` together; a chunk, for more see :func:`chunks`.

    Parameters
    ----------
    scenario : Scenario
        Its plant, disturbance and agreement rule; the law is the one given.
    law : CandidateLaw
    seed : int
    runs : range
        Numbers of the runs, each with its own streams.
    steps : int
    record : bool
        Keep states, candidates, inputs and gauges of every step.
    folder : Path
        Where the file of a network's measured delays is looked for.

    Raises
    ------
    SimulationError
        When a state leaves every set, or a program has no answer. With a network a step outside
        every set is a missed one.
    """
    R = len(runs)
    if R < 1 or steps < 1:
        raise ValueError(f"runs and steps: got {R} and {steps}, expected at least one of each")
    loop = _Loop(scenario, law, runs, seed)
    M, m, n = loop.M, loop.m, loop.n
    tosses = np.empty((steps, R), dtype=symbol_type(M))
    coin = np.empty_like(tosses) if scenario.network is not None else tosses
    symbol = np.empty((steps, R), dtype=symbol_type(M))
    largest = np.empty((steps, R))
    state_cost, input_effort, cost = np.zeros(R), np.zeros(R), np.zeros(R)
    Q, weight = scenario.cost_weights
    missed = missed_steps(scenario, seed=seed, runs=runs, steps=steps, folder=folder)
    made = np.zeros(R, dtype=np.intp)  # transitions so far
    everyone = np.arange(R)
    nobody = everyone[:0]
    xs = np.empty((steps + 1, scenario.readings, R)) if record else None
    us = np.empty((steps, M, m, R)) if record else None
    gs = np.empty((steps, M, R)) if record else None
    applied = np.empty((steps, m, R)) if record else None
    truth = np.empty((steps + 1, n, R)) if record and loop.noise is not None else None
    if xs is not None:
        xs[0] = loop.y
    if truth is not None:
        truth[0] = loop.x
    d = np.empty((0, n, R))
    for k in range(steps):
        place = k % BLOCK
        if place == 0:
            uniforms, coins = loop.draws.block(min(BLOCK, steps - k))
            d = disturbances(scenario.plant.disturbance, k, uniforms)
            tosses[k : k + len(coins)] = coins * M
        X = loop.states
        if missed is not None:
            missed[k] |= _outside(law, X)
            X = np.where(missed[k][:, None], 0.0, X)
        try:
            options = law.candidates_many(X, law.indices(X))
        except (OutsideError, ProgramError) as error:
            raise SimulationError(
                f"runs {runs.start} to {runs.stop - 1}, step {k}: {error}"
            ) from None
        tossed, without = tosses[k], nobody
        if missed is not None:  # draw j belongs to transition j
            tossed, without = tosses[made, everyone], np.flatnonzero(missed[k])
            coin[k] = np.where(missed[k], NO_SYMBOL, tossed)
            made += ~missed[k]
        columns = [[np.ascontiguousarray(options[:, j, i]) for i in range(m)] for j in range(M)]
        loop.step(columns, tossed, d[place], without)
        loop.verdict(symbol[k], largest[k])
        symbol[k, without], largest[k, without] = NO_SYMBOL, np.inf
        for i in range(n):
            np.multiply(loop.x[i], loop.x[i], out=loop.spare)
            np.add(state_cost, loop.spare, out=state_cost)
            cost += Q[i] * loop.spare
        for i in range(m):
            np.multiply(loop.u[i], loop.u[i], out=loop.spare)
            np.add(input_effort, loop.spare, out=input_effort)
            cost += weight[i] * loop.spare
        if xs is not None and us is not None and gs is not None and applied is not None:
            xs[k + 1] = loop.y
            us[k] = options.transpose(1, 2, 0)
            gs[k] = loop.gauges
            applied[k] = loop.u
            if truth is not None:
                truth[k + 1] = loop.x
            us[k][..., without] = gs[k][:, without] = np.nan
    return Runs(
        scenario=scenario,
        seed=seed,
        runs=runs,
        coin=coin,
        symbol=symbol,
        largest=largest,
        state_cost=state_cost,
        input_effort=input_effort,
        cost=cost,
        missed=missed,
        x=xs,
        candidates=us,
        gauges=gs,
        u=applied,
        truth=truth,
    )


def _outside(law: CandidateLaw, X: Array) -> NDArray[np.bool_]:
    """Which rows of X lie in no set, or have no answer: there the controller offers nothing."""
    out = np.zeros(len(X), dtype=bool)
    try:
        law.candidates_many(X, law.indices(X))
    except (OutsideError, ProgramError):
        for r, x in enumerate(X.tolist()):
            try:
                law.candidates(x)
            except LookupError:
                out[r] = True
    return out


def chunks(
    scenario: Scenario,
    law: CandidateLaw,
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
