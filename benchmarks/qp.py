"""One step's quadratic programs: our answer beside OSQP as it comes and DAQP, in one run.

Every solver gets the same states, targets and costs; states are drawn inside the sets with a stated
seed. A violation is by how much A x + B u leaves the target or u leaves U, in the unit of the rows.
"""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from controller_service.laws.base import ProgramLaw
from controller_service.laws.programs import Quadratic, solve_daqp, solve_osqp
from controller_service.sets.design import Design, synthesise
from protocol.arrays import Array
from protocol.convex import Polytope, corners
from protocol.scenario import Scenario

SEED = 1
STATES = 300
PLANTS = (("paper", (15, 250)), ("quadruple-tank", (11,)))

Solver = Callable[[Array, int, int], Array | None]


def states_in(design: Design, index: int, count: int, rng: np.random.Generator) -> Array:
    """States whose index is ``index`` > 0: just inside T_i on rays through the origin."""
    V = corners(*design.set(index))
    H, h = design.set(index)
    weights = rng.dirichlet(np.full(len(V), 0.2), size=4 * count)
    X = weights @ V
    gauge = (X @ H.T / h).max(axis=1)
    X = X / gauge[:, None] * 0.999
    before, bounds = design.set(index - 1)
    X = X[(bounds < X @ before.T).any(axis=1)]
    return np.asarray(X[:count])


def measure(
    plants: Sequence[tuple[str, tuple[int, ...]]] = PLANTS,
    states: int = STATES,
    *,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Time each way of solving the step's programs.

    Parameters
    ----------
    plants : sequence of (str, tuple of int)
        Shipped scenarios or files, and the indices of the states; one above a horizon stands for
        the horizon. A quick run takes one plant and a small index.
    states : int
        Programs are solved at this many states for each index, one for each cost.
    progress : callable, optional
        Told a line for each plant and index.

    Returns
    -------
    dict
        ``plants``: for each plant and index, ``rows``, ``states`` and for each solver the median,
        the 99th percentile (microseconds a program), the largest violation, the share of answers
        with one above 1e-6, the share unsolved, and its median over ours (``ratio``).
    """
    from runtime.scenario_file import scenario_of

    say = progress or (lambda _line: None)
    result: dict[str, Any] = {"seed": SEED, "plants": {}}
    for name, indices in plants:
        scenario = scenario_of(name)
        design = synthesise(scenario)
        rng = np.random.default_rng(SEED)
        at = result["plants"][scenario.name] = {}
        for index in sorted({min(i, design.horizon) for i in indices}):
            say(f"{name}, index {index} ...")
            X = states_in(design, index, states, rng)
            solvers, rows = _solvers(scenario, design, index - 1)
            entry: dict[str, Any] = {"rows": rows, "states": len(X), "solvers": {}}
            for solver, (solve, programs) in solvers.items():
                entry["solvers"][solver] = timed(solve, programs, X, index, scenario, design)
            ours = entry["solvers"]["wyner"]["median_us"]
            for figures in entry["solvers"].values():
                figures["ratio"] = figures["median_us"] / ours
            at[index] = entry
    return result


def timed(
    solve: Solver, programs: int, X: Array, index: int, scenario: Scenario, design: Design
) -> dict[str, float]:
    """Microseconds a program takes by one solver, and how good its answers are."""
    target = Polytope(*design.target(index - 1))
    inputs = Polytope.from_rows(*scenario.control.inputs.rows())
    times, worst, violated, unsolved, done = [], -np.inf, 0, 0, 0
    for x in X:
        for cost in range(len(scenario.control.costs) if programs == 1 else 1):
            begin = time.perf_counter()
            answer = solve(x, index, cost)
            times.append((time.perf_counter() - begin) / programs * 1e6)
            done += 1
            if answer is None or not np.isfinite(answer).all():
                unsolved += 1
                continue
            for u in np.atleast_2d(answer):
                excess = max(target.excess(design.A @ x + design.B @ u), inputs.excess(u))
                worst = max(worst, excess)
                violated += excess > 1e-6
    return {
        "median_us": statistics.median(times),
        "p99_us": float(np.percentile(times, 99)),
        "largest_violation": max(0.0, float(worst)),
        "violated_share": violated / (done * programs),
        "unsolved_share": unsolved / done,
    }


def _solvers(
    scenario: Scenario, design: Design, j: int
) -> tuple[dict[str, tuple[Solver, int]], int]:
    """Name, how to solve, and how many programs a call answers."""
    import osqp
    from scipy.sparse import csc_matrix, triu

    law = ProgramLaw(scenario, design)
    H, h = design.target(j)
    U = Polytope.from_rows(*scenario.control.inputs.rows())
    G = np.ascontiguousarray(np.vstack([H @ design.B, U.H]))
    HA = H @ design.A
    forms = [Quadratic.of(design.A, design.B, c) for c in scenario.control.costs]
    free = np.full(len(G), -np.inf)

    def room(x: Array) -> Array:
        return np.concatenate([h - HA @ x, U.h])

    def ours(x: Array, index: int, _cost: int) -> Array:
        return np.array(law.programs.candidates(x.tolist(), index))

    def daqp(x: Array, _index: int, cost: int) -> Array | None:
        return solve_daqp(forms[cost].P, forms[cost].F @ x, G, room(x))

    def careful(x: Array, _index: int, cost: int) -> Array | None:
        return solve_osqp(forms[cost].P, forms[cost].F @ x, G, room(x))

    def set_up(x: Array, cost: int) -> Any:
        solver = osqp.OSQP()
        solver.setup(
            P=csc_matrix(triu(forms[cost].P)),
            q=forms[cost].F @ x,
            A=csc_matrix(G),
            l=free,
            u=room(x),
            verbose=False,
        )
        return solver

    def answer(solver: Any) -> Array | None:
        result = solver.solve(raise_error=False)
        return np.array(result.x) if result.info.status == "solved" else None

    def fresh(x: Array, _index: int, cost: int) -> Array | None:
        return answer(set_up(x, cost))

    kept: dict[int, Any] = {}

    def updated(x: Array, _index: int, cost: int) -> Array | None:
        if cost not in kept:
            kept[cost] = set_up(x, cost)
        else:
            kept[cost].update(q=forms[cost].F @ x, u=room(x))
        return answer(kept[cost])

    return {
        "wyner": (ours, len(forms)),
        "DAQP, all rows": (daqp, 1),
        "OSQP fresh": (fresh, 1),
        "OSQP updated": (updated, 1),
        "OSQP 1e-9, polished": (careful, 1),
    }, len(G)


def _lines(result: dict[str, Any]) -> Iterator[str]:
    entries = [(name, at) for name, plant in result["plants"].items() for at in plant.items()]
    for name, (index, entry) in entries:
        yield (
            f"one step's programs of {name} at index {index}: {entry['rows']} rows, "
            f"{entry['states']} states, seed {result['seed']}"
        )
        yield (
            f"  {'solver':<20} {'median us':>10} {'99 % us':>10} {'ratio':>8} "
            f"{'violation':>10} {'> 1e-6':>7} {'unsolved':>8}"
        )
        for solver, f in entry["solvers"].items():
            yield (
                f"  {solver:<20} {f['median_us']:>10.1f} {f['p99_us']:>10.1f} {f['ratio']:>8.1f} "
                f"{f['largest_violation']:>10.1e} {f['violated_share']:>7.1%} "
                f"{f['unsolved_share']:>8.1%}"
            )


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` as tables."""
    return "\n".join(_lines(result))
