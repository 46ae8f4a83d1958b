"""Attacked steps a second: the engine beside the same attack on one run, step by step."""

import statistics
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from attacker_service.attacks.ghost import Ghost
from attacker_service.base import Model, Observation
from benchmarks.engine import shipped, timed
from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from plant_service.plant import Disturbances, LinearModel
from protocol.agreement import predict
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from protocol.secret.key_digits import fails
from protocol.streams import COIN, DISTURBANCE, Stream
from wyner.simulate.engine.attacks import Keys, attack_runs
from wyner.simulate.engine.defences import KeyedCoin

SEED: Final = 1
ROUNDS: Final = 5
RUNS, STEPS = 4096, 200
SCALAR_STEPS: Final = 2000
TARGET: Final = 1e6
"""Attacked steps a second and core."""


def engine_run(scenario: Scenario, law: CandidateLaw, runs: int, steps: int) -> int:
    """Runs of a ghost who has the key of a keyed coin; returns how many she stays unseen in."""
    model = Model.of(scenario)
    found = attack_runs(
        scenario,
        law,
        lambda draw: Ghost(model, {}, draw),
        [KeyedCoin(scenario.n, scenario.secrecy.candidates)],
        Keys(np.ones(runs, bool)),
        seed=[SEED],
        steps=steps,
        onset=1,
    )
    return int((found.alarmed == 0).sum())


def scalar_run(scenario: Scenario, law: CandidateLaw, steps: int) -> int:
    """The same on one run, through the functions of the services; returns its alarms."""
    noise, coins = Stream(SEED, DISTURBANCE, width=scenario.n), Stream(SEED, COIN)
    plant = LinearModel(scenario, Disturbances(scenario, noise))
    judge, size = rules_of(scenario).judge, scenario.secrecy.candidates
    ghost = Ghost(Model.of(scenario), {}, np.random.default_rng(SEED))
    x = shown = scenario.initial_state
    alarms = 0
    for k in range(steps):
        offered = law.candidates(shown)
        digit = int(coins.at(k)[0] * size)
        plant.begin(k, x, offered[digit])
        x = plant.end(k)
        told = Observation(k + 1, np.array(shown), np.array(offered), np.array(digit))
        reported = tuple(ghost.sensor(told).tolist())
        predictions = tuple(predict(scenario.A, scenario.B, shown, u) for u in offered)
        verdict = judge(shown, offered, predictions, reported)
        alarms += verdict.unexplained or fails(verdict.gauges, digit)
        shown = reported
    return alarms


def measure(
    rounds: int = ROUNDS,
    runs: int = RUNS,
    steps: int = STEPS,
    scalar_steps: int = SCALAR_STEPS,
    *,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Alternate the two ways for some rounds; medians of steps a second of processor time."""
    say = progress or (lambda _line: None)
    scenario = shipped("packed")
    law = make_law(scenario, cached_design(scenario))
    unseen = engine_run(scenario, law, runs, steps)
    alarms = scalar_run(scenario, law, scalar_steps)
    engine: list[float] = []
    scalar: list[float] = []
    for i in range(rounds):
        engine.append(runs * steps / timed(lambda: engine_run(scenario, law, runs, steps))[1])
        scalar.append(scalar_steps / timed(lambda: scalar_run(scenario, law, scalar_steps))[1])
        say(f"round {i + 1} of {rounds}: {engine[-1]:.3g} steps/s, one run {scalar[-1]:.3g}")
    return {
        "scenario": scenario.name,
        "seed": SEED,
        "rounds": rounds,
        "runs": runs,
        "steps": steps,
        "target": TARGET,
        "steps_per_second": statistics.median(engine),
        "spread": [min(engine), max(engine)],
        "scalar_steps_per_second": statistics.median(scalar),
        "ratio": statistics.median(engine) / statistics.median(scalar),
        "ratios": [e / s for e, s in zip(engine, scalar, strict=True)],
        "unseen": unseen,
        "alarms": alarms,
    }


def render(r: dict[str, Any]) -> str:
    """The figures in lines for people."""
    low, high = r["spread"]
    met = "met" if r["steps_per_second"] >= r["target"] else "missed"
    return "\n".join(
        [
            f"attacked steps, {r['scenario']}, {r['runs']} runs of {r['steps']} steps: "
            f"{r['steps_per_second']:.3g} steps/s a core [{low:.3g}, {high:.3g}]; target "
            f"{r['target']:.0e}: {met}",
            f"one run through the services' functions: {r['scalar_steps_per_second']:.3g} steps/s; "
            f"ratio {r['ratio']:.0f} ({min(r['ratios']):.0f} to {max(r['ratios']):.0f})",
            f"a ghost who has the key: unseen in {r['unseen']} of {r['runs']} runs, {r['alarms']} "
            "alarms in the one",
        ]
    )
