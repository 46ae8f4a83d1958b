"""Running a sweep: tasks for any executor, additive rows.

A point's runs come in batches. A task simulates one batch, and gives one row of counts for each
alpha that shares its trajectories. Rows of one point add up, and they are written in one order; so
a sweep that was stopped goes on where it ended, and it is the same rows whichever way it is run.
Where more runs are asked for later, a batch that was cut short gets a further row with the rest.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from typing import Any

from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import ProgramError
from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.design import SynthesisError
from protocol.scenario import Scenario
from protocol.schemes.framing import frame_length
from wyner.simulate.engine import Runs, SimulationError, follow, simulate_runs, transfer
from wyner.sweeps.code import loop_version
from wyner.sweeps.grid import (
    Group,
    Point,
    Row,
    Sweep,
    SweepError,
    describe,
    groups_of,
)
from wyner.sweeps.results import COUNTS, Results, key_of, tap_columns
from wyner.sweeps.workers import in_order


@lru_cache(maxsize=64)
def _law(substance: str) -> CandidateLaw:
    scenario = Scenario.model_validate_json(substance)
    return make_law(scenario, cached_design(scenario))


def run_task(
    scenario: str,
    alphas: Sequence[float],
    seed: int,
    first: int,
    runs: int,
    steps: int,
    eavesdroppers: Sequence[str] = (),
    message: str = "",
) -> tuple[str, list[Row] | str]:
    """Simulate one batch; the code's version, and the measured columns for each alpha.

    Instead of the columns one line where it cannot be simulated.

    Parameters
    ----------
    scenario : str
        As JSON: it travels to other processes and machines.
    alphas : sequence of float
    seed, first, runs, steps : int
        Runs ``first`` to ``first + runs - 1``.
    eavesdroppers : sequence of str
        Who listens, each by name or as ``FILE.py:CLASS``.
    message : str
        What every run sends while they do.
    """
    one = Scenario.model_validate_json(scenario)
    neutral = one
    if not one.control.knows_alpha:
        neutral = one.model_copy(update={"secrecy": one.secrecy.model_copy(update={"alpha": 1.0})})
    try:
        law = _law(neutral.model_dump_json(exclude={"description", "source"}))
        simulated = simulate_runs(
            one,
            law,
            seed=seed,
            runs=range(first, first + runs),
            steps=steps,
            record=bool(eavesdroppers),
        )
    except (SynthesisError, ProgramError, SimulationError) as error:
        return loop_version(), str(error)
    link = follow(simulated, alphas)
    x2, u2 = simulated.state_cost / steps, simulated.input_effort / steps
    common = {
        "period_s": one.plant.period_s,
        "candidates": one.secrecy.candidates,
        "steps": steps,
        "seed": seed,
        "first_run": first,
        "runs": runs,
    }
    sums = {
        "state_cost": float(x2.sum()),
        "state_cost_squares": float((x2 * x2).sum()),
        "input_effort": float(u2.sum()),
        "input_effort_squares": float((u2 * u2).sum()),
    }
    rows = []
    for i in range(len(alphas)):
        counts = {name: int(getattr(link, name)[i].sum()) for name in COUNTS}
        heard = _heard(simulated, alphas[i], eavesdroppers, message) if eavesdroppers else {}
        agreed = zip(link.agreements[i].tolist(), link.tested[i].tolist(), strict=True)
        by_run = {
            "runs_by_symbols": Counter((v,) for v in link.message_symbols[i].tolist()),
            "runs_by_agreed": Counter(agreed),
        }
        rows.append(common | counts | sums | by_run | heard)
    return loop_version(), rows


def _heard(runs: Runs, alpha: float, eavesdroppers: Sequence[str], message: str) -> Row:
    """What each eavesdropper got of these runs at one alpha."""
    from wyner.simulate.engine.taps import listen

    secrecy = runs.scenario.secrecy.model_copy(update={"alpha": alpha})
    runs = replace(runs, scenario=runs.scenario.model_copy(update={"secrecy": secrecy}))
    payload = message.encode()
    size = frame_length(len(payload), secrecy.candidates)
    link = transfer(runs, payloads=[payload] * (1 + runs.steps // size))
    of_runs = [listen(runs, link, eavesdroppers, place) for place in range(len(runs.runs))]
    row: Row = {}
    for i, eavesdropper in enumerate(eavesdroppers):
        mine = [of_run[i] for of_run in of_runs]
        sums = [sum(column) for column in zip(*map(astuple, mine), strict=True)]
        by_run = [
            Counter((got.known, got.agreements) for got in mine),
            Counter((got.read, got.delivered) for got in mine),
        ]
        row |= zip(tap_columns([name_of(eavesdropper)]), (*sums, *by_run), strict=True)
    return row


def name_of(eavesdropper: str) -> str:
    """What her columns are called: her name, as on every screen.

    Raises
    ------
    KnowledgeError
        When there is no such eavesdropper.
    """
    from tap_service.eavesdroppers import named

    return named(eavesdropper).name


Progress = Callable[[int, int], None]


def run_sweep(
    sweep: Sweep,
    points: Sequence[Point],
    results: Results,
    executor: Executor,
    progress: Progress | None = None,
) -> list[str]:
    """Run what is missing; rows are written in one order, whatever the executor.

    Parameters
    ----------
    progress : callable, optional
        Called with the runs that are done and the runs that are foreseen.

    Returns
    -------
    list of str
        One line for each group of points that could not be simulated.

    Raises
    ------
    SweepError
        When a worker has another version of the code.
    """
    groups = groups_of(points)
    done: dict[tuple[str, str, str], list[Row]] = {}
    for row in results.rows:
        done.setdefault(key_of(row), []).append(row)
    tasks = [task for group in groups for task in _missing(group, done, sweep)]
    finished, foreseen = 0, sum(task.runs for task in tasks)
    ready = (task for task in tasks if not task.group.failure)
    for task, (version, answer) in in_order(
        executor, run_task, ready, lambda one: one.arguments(sweep)
    ):
        if version != loop_version():
            raise SweepError(f"a worker has code version {version}, this is {loop_version()}")
        finished += task.runs
        if isinstance(answer, str):
            task.group.failure = answer
        elif not task.group.failure:
            for point, measured in zip(task.points, answer, strict=True):
                results.add(point, measured)
        if progress is not None:
            progress(finished, foreseen)
    return [f"{describe(g.points[0])}: {g.failure}" for g in groups if g.failure]


@dataclass(frozen=True)
class _Task:
    """Runs of one batch of a group, for the points that lack them."""

    group: Group
    points: list[Point]
    first: int
    runs: int

    def arguments(self, sweep: Sweep) -> tuple[Any, ...]:
        """What :func:`run_task` takes."""
        text = self.points[0].scenario.model_dump_json()
        alphas = [p.scenario.secrecy.alpha for p in self.points]
        loop = (text, alphas, sweep.seed, self.first, self.runs, sweep.steps)
        return (*loop, list(sweep.eavesdroppers), sweep.message) if sweep.eavesdroppers else loop


def _missing(
    group: Group, done: dict[tuple[str, str, str], list[Row]], sweep: Sweep
) -> Iterator[_Task]:
    """What follows the rows of each point, batch by batch."""
    at = {p.key: sum(row["runs"] for row in done.get(p.key, ())) for p in group.points}
    while (first := min(at.values())) < sweep.runs:
        points = [p for p in group.points if at[p.key] == first]
        runs = min(sweep.batch - first % sweep.batch, sweep.runs - first)
        yield _Task(group, points, first, runs)
        at |= {p.key: first + runs for p in points}
