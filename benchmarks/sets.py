"""How long the paper's sets take beside the ``polytope`` package, in one run.

The same work for both: from the same T_0, T_1..T_N. Three routes of that package are measured: by
corners (``extreme`` and ``qhull``), the same without removing redundant rows first, and by its
projection of the sets of (x, u). Each stops at a bound of time. Between any two of the package's
steps our whole synthesis runs once, so that load on the machine meets both alike.
A route is right as long as its sets are ours, which tests certify by exact fractions.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from controller_service.sets.design import Design, synthesise
from protocol.arrays import Array
from protocol.convex import SetError, corners
from protocol.scenario import Scenario

HORIZONS = (20, 50, 250)
MISSING = "the package polytope is not installed: pip install polytope"

RIGHT = 1e-6
"""A set of the package counts as wrong when its relative error is larger."""

UNBOUNDED = 1e6
"""Reported as the relative error of a set that has become unbounded."""

Rows = tuple[Array, Array]


class Route(NamedTuple):
    """One way of the package's: from (H, h) to its set, one step, and back to (H, h)."""

    start: Callable[[Rows], Any]
    step: Callable[[Any], Any]
    rows: Callable[[Any], Rows]


@dataclass
class Ours:
    """Our synthesis at one horizon, and how long it took each time, in seconds."""

    scenario: Scenario
    whole: list[float] = field(default_factory=list)
    recursion: list[float] = field(default_factory=list)

    @classmethod
    def at(cls, scenario: Scenario, horizon: int) -> "Ours":
        """The scenario's synthesis up to T_horizon."""
        control = scenario.control.model_copy(update={"horizon": horizon})
        return cls(scenario.model_copy(update={"control": control}))

    def run(self) -> Design:
        """Once: the time of all of it, and of T_1..T_N alone."""
        marks: list[float] = []
        begin = time.perf_counter()
        design = synthesise(self.scenario, lambda _done, _total: marks.append(time.perf_counter()))
        end = time.perf_counter()
        self.whole.append(end - begin)
        self.recursion.append(end - marks[0])  # marks[0]: T_0 and its target stand
        return design


def measure(
    scenario: Scenario | None = None,
    seconds: float = 40.0,
    repeats: int = 15,
    rounds: int = 3,
    horizons: tuple[int, int, int] = HORIZONS,
    *,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run the comparison; ``seconds`` bounds each of the package's routes.

    Parameters
    ----------
    scenario : Scenario, optional
        A planar plant with one input, box D_c and symmetric U; the paper's where none is given.
    repeats : int
        Our synthesis is timed this often at each horizon; medians are reported.
    rounds : int
        The fastest right route is timed this often up to the middle horizon.
    horizons : tuple of int
        Where to compare. A quick run takes small ones.
    progress : callable, optional
        Told a line for each horizon of ours, and for each of the package's routes.

    Returns
    -------
    dict
        ``ratio`` is the fastest right route's time over ours for T_1..T_N at the middle N (neither
        side's T_0), the median of ``ratios``, one for each round; ``ratio_with_terminal_set`` the
        same with our T_0, gain and checks counted against us. Without the package the ratios are
        None and ``missing`` says so.

    Raises
    ------
    ValueError
        When the scenario is of another kind.
    """
    if scenario is None:
        from runtime.scenario_file import scenario_of

        scenario = scenario_of("paper")
    say = progress or (lambda _line: None)
    middle = horizons[1]
    result: dict[str, Any] = {
        "scenario": scenario.name,
        "at": middle,
        "ours": {},
        "ratio": None,
        "ratio_with_terminal_set": None,
        "ratio_target": 500,
        "routes": {},
    }
    sets: list[Rows] = []
    for N in reversed(horizons):
        ours = Ours.at(scenario, N)
        design = [ours.run() for _ in range(repeats)][-1]
        sets = sets or [design.set(i) for i in range(N + 1)]
        result["ours"][N] = {
            "seconds": statistics.median(ours.whole),
            "recursion_seconds": statistics.median(ours.recursion),
            "spread": [min(ours.whole), max(ours.whole)],
            "facets": design.facets[N],
        }
        say(f"T_{N}: {statistics.median(ours.whole):.4f} s, {design.facets[N]} facets")
    try:
        routes = _routes(scenario)
    except ImportError:
        result["missing"] = MISSING
        return result
    first = design.set(0)
    right: dict[str, list[tuple[float, float]]] = {}
    for name, route in routes.items():
        ours = Ours.at(scenario, middle)
        entry = _run_route(route, first, horizons, sets, seconds, ours)
        result["routes"][name] = entry
        say(f"route {name}: up to T_{max(entry['at'], default=0)}")
        if middle in entry["at"]:
            entry["ratio"], whole_ratio = _ratios(entry["at"][middle]["seconds"], ours)
            if max(abs(v) for v in entry["at"][middle]["relative_error"]) < RIGHT:
                right[name] = [(entry["ratio"], whole_ratio)]
    if right:
        fastest = min(right, key=lambda name: result["routes"][name]["at"][middle]["seconds"])
        pairs = right[fastest]
        for _ in range(rounds - 1):
            ours = Ours.at(scenario, middle)
            pairs.append(_ratios(_time_route(routes[fastest], first, middle, ours), ours))
        result["fastest_right_route"] = fastest
        result["ratios"] = [ratio for ratio, _ in pairs]
        result["ratio"] = statistics.median(result["ratios"])
        result["ratio_with_terminal_set"] = statistics.median(ratio for _, ratio in pairs)
    return result


def _ratios(seconds: float, ours: Ours) -> tuple[float, float]:
    """A route's time over ours, without and with our T_0."""
    return seconds / statistics.median(ours.recursion), seconds / statistics.median(ours.whole)


def _time_route(route: Route, first: Rows, horizon: int, ours: Ours) -> float:
    """Seconds of a route up to a horizon that it reaches, ours run between its steps."""
    state, spent = route.start(first), 0.0
    for _ in range(horizon):
        begin = time.perf_counter()
        state = route.step(state)
        spent += time.perf_counter() - begin
        ours.run()
    return spent


def relative_errors(H: Array, h: Array, ours: Rows) -> tuple[float, float]:
    """Largest and smallest relative difference of a set's support from ours.

    Both sets' normals are looked at, so that a facet that is missing shows.
    """
    try:
        theirs, mine = corners(H, h), corners(*ours)
    except SetError:
        return UNBOUNDED, -1.0
    errors = np.concatenate(
        (h / (H @ mine.T).max(axis=1) - 1, (ours[0] @ theirs.T).max(axis=1) / ours[1] - 1)
    )
    return float(errors.max()), float(errors.min())


def _run_route(
    route: Route,
    first: Rows,
    horizons: tuple[int, int, int],
    sets: list[Rows],
    seconds: float,
    ours: Ours,
) -> dict[str, Any]:
    """Time one route as far as it gets; ours between its steps and accuracy are off its clock."""
    state = route.start(first)
    spent, at, wrong_from, reached, reason = 0.0, {}, None, 0, "done"
    for i in range(1, horizons[-1] + 1):
        begin = time.perf_counter()
        try:
            state = route.step(state)
        except Exception as error:  # the package's own failure is a result
            reason = f"{type(error).__name__}: {str(error)[:80]}"
            break
        spent += time.perf_counter() - begin
        reached = i
        H, h = route.rows(state)
        if len(h) < 3:
            reason = "the set became empty"
            break
        if i <= horizons[1]:
            ours.run()
        if i in horizons or i % 10 == 0:
            errors = relative_errors(H, h, sets[i])
            if wrong_from is None and max(abs(v) for v in errors) > RIGHT:
                wrong_from = i
            if i in horizons:
                at[i] = {"seconds": spent, "facets": len(h), "relative_error": errors}
        if spent > seconds:
            reason = f"stopped after {seconds:g} s"
            break
    return {
        "reached": reached,
        "seconds": spent,
        "end": reason,
        "wrong_from": wrong_from,
        "at": at,
        "our_facets": len(sets[reached][1]),
    }


def _routes(scenario: Scenario) -> dict[str, Route]:
    """The package's routes, by name."""
    import contextlib
    import io
    import warnings

    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import polytope

    A, B = np.array(scenario.A), np.array(scenario.B)
    assert scenario.defender.disturbance.half_widths is not None
    assert scenario.control.inputs.half_widths is not None
    widths = np.array(scenario.defender.disturbance.half_widths)
    u = float(scenario.control.inputs.half_widths[0])

    def start(rows: Rows) -> Any:
        return polytope.Polytope(*rows)

    def rows(p: Any) -> Rows:
        return p.A, p.b

    def by_corners(reduced: bool) -> Callable[[Any], Any]:
        def step(T: Any) -> Any:
            # Said to be minimal, the package spares a linear program for each row.
            S = polytope.Polytope(T.A, T.b - np.abs(T.A) @ widths, minrep=reduced)
            V = polytope.extreme(S)
            hull = polytope.qhull(np.vstack([V + u * B.T, V - u * B.T]))
            return polytope.Polytope(hull.A @ A, hull.b)

        return step

    def by_projection(T: Any) -> Any:
        S = polytope.reduce(polytope.Polytope(T.A, T.b - np.abs(T.A) @ widths))
        both = polytope.Polytope(
            np.vstack([np.hstack([S.A @ A, S.A @ B]), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]),
            np.concatenate([S.b, [u, u]]),
        )
        return polytope.projection(both, [1, 2])

    return {
        "corners": Route(start, by_corners(False), rows),
        "corners, unreduced": Route(start, by_corners(True), rows),
        "projection": Route(start, by_projection, rows),
    }


def _lines(result: dict[str, Any]) -> Iterator[str]:
    middle = result["at"]
    yield f"sets of {result['scenario']}: T_1..T_N from the same T_0, seconds (median of ours)"
    yield f"{'route':<28} {'N':>4} {'seconds':>10} {'facets':>7}  relative difference from ours"
    for N, r in sorted(result["ours"].items()):
        yield f"{'wyner':<28} {N:>4} {r['recursion_seconds']:>10.4f} {r['facets']:>7}"
    for name, route in result["routes"].items():
        for N, r in route["at"].items():
            out, inward = r["relative_error"]
            yield (
                f"{'polytope ' + name:<28} {N:>4} {r['seconds']:>10.4f} {r['facets']:>7}  "
                f"{out:.2g}, {inward:.2g}"
            )
        wrong = route["wrong_from"]
        ratio = f", {route['ratio']:.0f} times ours at N = {middle}" if "ratio" in route else ""
        yield (
            f"polytope {name}: reached {route['reached']} in {route['seconds']:.1f} s "
            f"({route['end']}), "
            + ("right so far" if wrong is None else f"wrong by more than 1e-6 from {wrong} on")
            + ratio
        )
    if "missing" in result:
        yield result["missing"]
    if result["ratio"] is not None:
        met = "met" if result["ratio"] >= result["ratio_target"] else "missed"
        yield (
            f"ratio at N = {middle} to the fastest right route: {result['ratio']:.0f}, "
            f"{min(result['ratios']):.0f} to {max(result['ratios']):.0f} in "
            f"{len(result['ratios'])} rounds (target {result['ratio_target']}: {met}), "
            f"{result['ratio_with_terminal_set']:.0f} with our T_0 and checks counted"
        )


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` as a table."""
    return "\n".join(_lines(result))
