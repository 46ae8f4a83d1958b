"""The engine beside the services' cores on a virtual clock."""

import statistics
import time
from collections.abc import Callable
from typing import Any, Final

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from wyner.simulate.engine import chunks, follow, simulate_runs
from wyner.simulate.network import Simulation

SEED: Final = 1
ROUNDS: Final = 5
RUNS, STEPS = 4096, 200
CORE_STEPS: Final = 1000
ALPHAS: Final = tuple(1.5 + 0.5 * i for i in range(14))
INITIAL_STATES: Final = ((1.0, -0.5), (4.0, -2.0), (-12.0, 6.0))


def shipped(name: str) -> Scenario:
    """A shipped scenario."""
    from runtime.scenario_file import scenario_of

    return scenario_of(name)


def cores_run(scenario: Scenario, law: CandidateLaw, steps: int) -> None:
    """One run of the services' own cores on a virtual clock."""
    Simulation(scenario, law, seed=SEED).run(steps=steps)


def engine_run(scenario: Scenario, law: CandidateLaw, runs: int, steps: int) -> None:
    """Many runs with the automata at the scenario's alpha."""
    for part in chunks(scenario, law, seed=SEED, runs=range(runs), steps=steps):
        follow(part, [scenario.secrecy.alpha])


def paper_sweep() -> float:
    """Seconds of the paper's whole sweep, from reading the cached design to every rate."""
    begin = time.perf_counter()
    scenario = shipped("paper")
    law = make_law(scenario, cached_design(scenario))
    for x in INITIAL_STATES:
        plant = scenario.plant.model_copy(update={"initial_state": x})
        one = scenario.model_copy(update={"plant": plant})
        follow(simulate_runs(one, law, seed=SEED, runs=range(20), steps=50), ALPHAS)
    return time.perf_counter() - begin


def timed(call: Callable[[], object]) -> tuple[float, float]:
    """Seconds of wall time and of this process's processor time."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - wall, time.process_time() - cpu


def measure(
    rounds: int = ROUNDS,
    runs: int = RUNS,
    steps: int = STEPS,
    core_steps: int = CORE_STEPS,
    *,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Alternate the two ways for some rounds; medians, and the ratio of the medians.

    ``steps_per_second`` counts seconds of processor time: steps a second a core, whoever else uses
    the machine. ``ratio`` is by the same clock, ``wall_ratio`` by the wall's.
    ``progress`` is told a line a round.
    """
    say = progress or (lambda _line: None)
    scenario = shipped("sustained")
    law = make_law(scenario, cached_design(scenario))
    ways: dict[str, tuple[int, Callable[[], object]]] = {
        "engine": (runs * steps, lambda: engine_run(scenario, law, runs, steps)),
        "cores": (core_steps, lambda: cores_run(scenario, law, core_steps)),
    }
    engine_run(scenario, law, runs, steps)
    wall: dict[str, list[float]] = {name: [] for name in ways}
    cpu: dict[str, list[float]] = {name: [] for name in ways}
    for i in range(rounds):
        for name, (count, call) in ways.items():
            seconds, processor = timed(call)
            wall[name].append(count / seconds)
            cpu[name].append(count / processor)
        ratio = cpu["engine"][-1] / cpu["cores"][-1]
        say(f"round {i + 1} of {rounds}: {cpu['engine'][-1]:.0f} steps/s, ratio {ratio:.0f}")
    rate = {name: statistics.median(values) for name, values in cpu.items()}
    wall_rate = {name: statistics.median(values) for name, values in wall.items()}
    return {
        "scenario": scenario.name,
        "seed": SEED,
        "rounds": rounds,
        "runs": runs,
        "steps": steps,
        "steps_per_second": rate["engine"],
        "spread": [min(cpu["engine"]), max(cpu["engine"])],
        "wall_steps_per_second": wall_rate["engine"],
        "ratio": rate["engine"] / rate["cores"],
        "ratios": [e / s for e, s in zip(cpu["engine"], cpu["cores"], strict=True)],
        "wall_ratio": wall_rate["engine"] / wall_rate["cores"],
        "cores_steps_per_second": rate["cores"],
        "paper_sweep_seconds": statistics.median(paper_sweep() for _ in range(rounds)),
    }


def render(r: dict[str, Any]) -> str:
    """The figures in lines for people."""
    low, high = r["spread"]
    lines = [
        f"engine, {r['scenario']}, {r['runs']} runs of {r['steps']} steps: "
        f"{r['steps_per_second']:.3g} steps/s a core [{low:.3g}, {high:.3g}]; by the wall clock "
        f"{r['wall_steps_per_second']:.3g}",
        f"the services' cores on a virtual clock: {r['cores_steps_per_second']:.3g} steps/s",
        f"ratio {r['ratio']:.0f} (medians of {r['rounds']} alternating rounds, processor time; by "
        f"the wall clock {r['wall_ratio']:.0f})",
        f"the paper's sweep, 14 alphas, 3 initial states, 20 runs of 50 steps: "
        f"{r['paper_sweep_seconds']:.3f} s",
    ]
    return "\n".join(lines)
