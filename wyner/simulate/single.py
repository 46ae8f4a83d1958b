"""The scalar closed loop, and the runs of any plant in it, with what the engine keeps of a run.

For plants that the engine cannot step: a function, an object, an FMU, an environment. The numbers
drawn are those of the engine and of the services with a seed, so that a linear plant gives the same
run here, there and on the network.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np

from plant_service.adapters import Operated, PlantError
from plant_service.adapters.registry import NOISE_OF_ITS_OWN
from plant_service.disturbance import disturbance
from protocol.agreement import INSIDE, NO_SYMBOL, AgreementResult, spread
from protocol.agreement import predict as predict_linear
from protocol.box_observer import Box, Estimate
from protocol.link.fallback import Fallback
from protocol.link.filters import Filter, read_through, sensors_of
from protocol.link.outputs import OutputRule
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from protocol.scenario.plant import Disturbance
from protocol.streams import COIN, DISTURBANCE, SENSOR, SeededSymbols, Stream
from protocol.vectors import Vector
from runtime.model import load_model
from wyner.simulate.engine.draws import symbol_type
from wyner.simulate.engine.loop import Runs, SimulationError
from wyner.simulate.missed import missed_steps


class Law(Protocol):
    """What the loop needs of a control law."""

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The M candidate inputs at ``x``."""


class Moved(NamedTuple):
    """A step of the loop: where the plant was, what it could choose from, and what came of it.

    One that was missed has no candidates, no coin and a verdict without gauges.
    """

    k: int
    x: Vector
    candidates: tuple[Vector, ...]
    coin: int
    x_next: Vector
    verdict: AgreementResult
    u: Vector


NO_VERDICT: Final = AgreementResult((), NO_SYMBOL)
"""Of a step without an offer."""


Judge = Callable[[Vector, tuple[Vector, ...], tuple[Vector, ...], Vector], AgreementResult]


def closed_loop(
    candidates: Callable[[Vector], tuple[Vector, ...]],
    judge: Judge,
    coin: Callable[[int], int],
    move: Callable[[int, Vector, Vector], Vector],
    x: Vector,
    steps: int,
    predict: Callable[[Vector, Vector], Vector] | None = None,
    missed: Sequence[bool] = (),
    fallback: Callable[[Vector, Vector], Vector] | None = None,
    u: Vector = (),
) -> Iterator[Moved]:
    """The loop itself: propose, choose, move, judge; whatever draws numbers is handed in.

    Parameters
    ----------
    candidates : callable
        x to the M inputs.
    judge : callable
        (x, candidates, predictions, x_next) to the verdict:
        :attr:`protocol.link.session.Rules.judge`.
    coin : callable
        k to b_r, the index of the input to apply.
    move : callable
        (k, x, u) to x_next.
    x : tuple of float, shape (n,)
    steps : int
    predict : callable, optional
        A nonlinear f_c: (x, u) to where it predicts the next state.
    missed : sequence of bool
        Which steps have no offer; none where it is empty. In them ``fallback`` is applied.
    fallback : callable, optional
        (x, u in force) to the input of a missed step.
    u : tuple of float, shape (m,)
        What is in force before the first step.
    """
    j = 0
    for k in range(steps):
        if missed and missed[k]:
            assert fallback is not None, "a step may be missed, and nothing says what is applied"
            u = fallback(x, u)
            x_next = move(k, x, u)
            yield Moved(k, x, (), NO_SYMBOL, x_next, NO_VERDICT, u)
            x = x_next
            continue
        offered = candidates(x)
        predictions = () if predict is None else tuple([predict(x, u) for u in offered])
        b = coin(j)
        j, u = j + 1, offered[b]
        x_next = move(k, x, u)
        yield Moved(k, x, offered, b, x_next, judge(x, offered, predictions, x_next), u)
        x = x_next


class Boxed:
    """What both ends reckon with where outputs alone are read: a box that each transition moves.

    Its methods are the `candidates`, ``judge`` and ``fallback`` of :func:`closed_loop`, whose x are
    readings.

    Parameters
    ----------
    rule : OutputRule
    propose : callable
        A state to the M inputs.
    """

    def __init__(self, rule: OutputRule, propose: Callable[[Vector], tuple[Vector, ...]]) -> None:
        self._rule, self._propose = rule, propose
        self._estimate: Estimate | None = None
        self._missed = 0
        self._box: Box

    def candidates(self, y: Vector) -> tuple[Vector, ...]:
        """Around the centre of the box."""
        self._box = self._rule.box(self._estimate, self._missed, y)
        return self._propose(self._box.centre)

    def judge(
        self, _y: Vector, candidates: tuple[Vector, ...], _predictions: object, y_next: Vector
    ) -> AgreementResult:
        """The verdict; the box moves on."""
        verdict = self._rule.judge(self._box, candidates, y_next)
        self._estimate, self._missed = verdict.estimate, 0
        return verdict

    def fallback(self, _y: Vector, u: Vector) -> Vector:
        """The input of one more missed step."""
        instead = self._rule.instead(self._estimate, self._missed, u)
        self._missed += 1
        return instead

    def widest(self, candidates: tuple[Vector, ...]) -> float:
        """The least alpha at which she finds each candidate of the last transition possible."""
        return 1.0 + spread(self._rule.apart, self._rule.predictions(self._box, candidates))


def step_plant(
    plant: Operated, spec: Disturbance, u: Vector, d: tuple[float, ...] | None
) -> tuple[Vector, Vector]:
    """Apply an input and sample; the input that was really applied, and the next state.

    ``d`` reaches the plant where the disturbance enters; None where there is none to hand over.
    """
    applied = plant.apply(u, d if spec.enters == "input" else None)
    return applied, plant.sample(d if spec.enters in (None, "state") else None)


def simulate_plant(
    scenario: Scenario,
    law: Law,
    open_plant: Callable[[], Operated],
    *,
    seed: int,
    runs: range,
    steps: int,
    folder: Path = Path(),
) -> Runs:
    """Simulate ``runs`` of a plant, with a record.

    Parameters
    ----------
    scenario : Scenario
        Its agreement rule, candidates and disturbance.
    law : Law
    open_plant : callable
        A new plant for each run; it is closed when the run ends.
    seed : int
    runs : range
        Numbers of the runs, each with its own streams.
    steps : int
    folder : Path
        Where the file of a nonlinear f_c is looked for.

    Raises
    ------
    SimulationError
        When a state leaves every set, or the plant fails; the message names run and step. Also for
        a device of which outputs alone are read: its states are not known.
    """
    n, m, M = scenario.n, scenario.m, scenario.secrecy.candidates
    spec = scenario.plant.disturbance
    width = len(spec.half_widths)
    R = len(runs)
    if R < 1 or steps < 1:
        raise ValueError(f"runs and steps: got {R} and {steps}, expected at least one of each")
    rules = rules_of(scenario)
    judge, predict = rules.judge, load_model(scenario, folder)
    rule, own_shape = rules.agreement, scenario.secrecy.disturbance is not None
    f_c = predict or partial(predict_linear, scenario.A, scenario.B)
    coin = np.empty((steps, R), dtype=symbol_type(M))
    symbol = np.empty((steps, R), dtype=symbol_type(M))
    xs = np.empty((steps + 1, scenario.readings, R))
    us = np.empty((steps, M, m, R))
    gs = np.empty((steps, M, R))
    applied = np.empty((steps, m, R))
    noise_of, outputs = scenario.plant.noise, rules.outputs
    whole = noise_of is None and outputs is None
    truth = None if whole else np.empty((steps + 1, n, R))
    missed = missed_steps(scenario, seed=seed, runs=runs, steps=steps, folder=folder)
    fallback = Fallback.of(scenario).input
    largest = np.empty((steps, R))
    for place, run in enumerate(runs):
        coins = SeededSymbols(seed, COIN, run=run)
        noise = Stream(seed, DISTURBANCE, width=width, run=run)
        plant, k = open_plant(), -1
        draws = Stream(seed, SENSOR, width=scenario.readings, run=run)
        sensors = sensors_of(scenario, draws)
        boxed = None if outputs is None else Boxed(outputs, law.candidates)

        def read(
            k: int, x: Vector, place: int = place, sensors: Sequence[Filter] = sensors
        ) -> Vector:
            if truth is None:
                return x
            truth[k, :, place] = x
            return read_through(sensors, k, x)[0]

        def move(
            k: int,
            _y: Vector,
            u: Vector,
            plant: Operated = plant,
            noise: Stream = noise,
            read: Callable[[int, Vector], Vector] = read,
        ) -> Vector:
            d = None if width == 0 else disturbance(spec, k, noise.at(k))
            return read(k + 1, step_plant(plant, spec, u, d)[1])

        propose = law.candidates
        test: Judge = judge
        instead: Callable[[Vector, Vector], Vector] = fallback
        if boxed is not None:
            propose, test, instead = boxed.candidates, boxed.judge, boxed.fallback
        try:
            if outputs is not None and plant.device:
                text = "plant.C: expected none of a device here, as its states are not known; the "
                raise SimulationError(f"{text}two ends and wyner up run it")
            if noise_of is not None and plant.device:
                raise SimulationError(NOISE_OF_ITS_OWN)
            x = read(0, plant.start(seed + run))
            xs[0, :, place] = x
            toss = partial(coins.symbol, size=M)
            holes = () if missed is None else missed[:, place].tolist()
            for t in closed_loop(
                propose, test, toss, move, x, steps, predict, holes, instead, (0.0,) * m
            ):
                k = t.k
                coin[k, place] = t.coin
                xs[k + 1, :, place] = t.x_next
                applied[k, :, place] = t.u
                if not t.candidates:
                    symbol[k, place], largest[k, place] = NO_SYMBOL, np.inf
                    us[k, :, :, place] = gs[k, :, place] = np.nan
                    continue
                gauges = t.verdict.gauges
                inside = [i for i, g in enumerate(gauges) if g <= INSIDE]
                symbol[k, place] = inside[0] if len(inside) == 1 else NO_SYMBOL
                us[k, :, :, place] = t.candidates
                gs[k, :, place] = gauges
                if boxed is not None:
                    largest[k, place] = boxed.widest(t.candidates)
                    continue
                by_rule = own_shape or rule.apart is not None
                predictions = [f_c(t.x, u) for u in t.candidates] if by_rule else ()
                largest[k, place] = rule.widest(predictions, t.x_next) if by_rule else max(gauges)
        except (LookupError, PlantError) as error:
            raise SimulationError(f"run {run}, step {k + 1}: {error}") from None
        finally:
            plant.close()
    states = xs if truth is None else truth
    Q, weight = (np.array(w)[:, None] for w in scenario.cost_weights)
    return Runs(
        scenario=scenario,
        seed=seed,
        runs=runs,
        coin=coin,
        symbol=symbol,
        largest=largest,
        state_cost=(states[1:] ** 2).sum(axis=(0, 1)),
        input_effort=(applied**2).sum(axis=(0, 1)),
        cost=(Q * states[1:] ** 2).sum(axis=(0, 1)) + (weight * applied**2).sum(axis=(0, 1)),
        missed=missed,
        x=xs,
        candidates=us,
        gauges=gs,
        u=applied,
        truth=truth,
    )
