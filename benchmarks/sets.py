"""How long the paper's sets take beside the ``polytope`` package, in one run.

The same work for both: from the same T_0, T_1..T_N. Of that package the fastest way that stays
right is taken: by corners (``extreme`` and ``qhull``). Between any two of its steps our whole
synthesis runs once, so that load on the machine meets both alike. Its sets must be ours, which
tests certify by exact fractions.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from controller_service.sets.design import Design, synthesise
from protocol.arrays import Array
from protocol.convex import corners
from protocol.scenario import Scenario
from runtime.errors import UsageError, needs
from runtime.scenario_file import scenario_of

HORIZON: Final = 50
ROUNDS: Final = 3
TARGET: Final = 500

RIGHT: Final = 1e-6
"""A set of the package is wrong when its relative error is larger."""

Rows = tuple[Array, Array]


class Ours:
    """Our synthesis up to T_N, and how long it took each time, in seconds."""

    def __init__(self, scenario: Scenario, horizon: int) -> None:
        control = scenario.control.model_copy(update={"horizon": horizon})
        self._scenario = scenario.model_copy(update={"control": control})
        self.whole: list[float] = []
        self.recursion: list[float] = []

    def run(self) -> Design:
        """Once: the time of all of it, and of T_1..T_N alone."""
        marks: list[float] = []
        begin = time.perf_counter()
        design = synthesise(self._scenario, lambda _done, _total: marks.append(time.perf_counter()))
        end = time.perf_counter()
        self.whole.append(end - begin)
        self.recursion.append(end - marks[0])  # marks[0]: T_0 and its target stand
        return design


def measure(
    *,
    horizon: int = HORIZON,
    rounds: int = ROUNDS,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run the comparison on the paper's plant.

    Parameters
    ----------
    horizon : int
        N.
    rounds : int
    progress : callable, optional
        Told a line for each round.

    Returns
    -------
    dict
        ``ratio`` is the package's time over ours for T_1..T_N (neither side's T_0), the median of
        ``ratios``, one for each round; ``ratio_with_terminal_set`` the same with our T_0, gain and
        checks counted against us; ``relative_error`` the largest of the package's T_N.
    """
    scenario = scenario_of("paper")
    design = Ours(scenario, horizon).run()
    say = progress or (lambda _line: None)
    seconds, ours, ratios, with_ours = [], [], [], []
    error = 0.0
    for _ in range(rounds):
        mine = Ours(scenario, horizon)
        spent, last = _by_corners(scenario, design.set(0), horizon, mine)
        error = max(error, relative_error(last, design.set(horizon)))
        seconds.append(spent)
        ours.append(statistics.median(mine.recursion))
        ratios.append(spent / ours[-1])
        with_ours.append(spent / statistics.median(mine.whole))
        say(f"T_1 to T_{horizon}: {ours[-1]:.4f} s, the package {spent:.2f} s")
    return {
        "scenario": scenario.name,
        "at": horizon,
        "seconds": statistics.median(ours),
        "package_seconds": statistics.median(seconds),
        "relative_error": error,
        "ratios": ratios,
        "ratio": statistics.median(ratios),
        "ratio_with_terminal_set": statistics.median(with_ours),
    }


def _by_corners(scenario: Scenario, first: Rows, horizon: int, ours: Ours) -> tuple[float, Rows]:
    """Seconds that the package takes to T_N, ours run between its steps; and its T_N."""
    try:
        import polytope
    except ImportError:
        raise UsageError(needs("bench", "polytope")) from None
    A, B = np.array(scenario.A), np.array(scenario.B)
    widths = np.array(scenario.defender.disturbance.half_widths)
    u = float(np.array(scenario.control.inputs.half_widths)[0])
    T, spent = polytope.Polytope(*first), 0.0
    for _ in range(horizon):
        begin = time.perf_counter()
        V = polytope.extreme(polytope.Polytope(T.A, T.b - np.abs(T.A) @ widths))
        hull = polytope.qhull(np.vstack([V + u * B.T, V - u * B.T]))
        T = polytope.Polytope(hull.A @ A, hull.b)
        spent += time.perf_counter() - begin
        ours.run()
    return spent, (T.A, T.b)


def relative_error(theirs: Rows, ours: Rows) -> float:
    """The largest relative difference of a set's support from ours.

    Both sets' normals are looked at, so that a facet that is missing shows.
    """
    outer, inner = corners(*theirs), corners(*ours)
    (H, h), (mine, bound) = theirs, ours
    errors = np.concatenate(
        (h / (H @ inner.T).max(axis=1) - 1, (mine @ outer.T).max(axis=1) / bound - 1)
    )
    return float(np.abs(errors).max())


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` for people."""
    ratios = result["ratios"]
    met = "met" if result["ratio"] >= TARGET else "missed"
    same = "right" if result["relative_error"] < RIGHT else "WRONG"
    return "\n".join(
        [
            f"sets of {result['scenario']}: T_1..T_{result['at']} from the same T_0",
            f"wyner {result['seconds']:.4f} s, polytope {result['package_seconds']:.2f} s; its "
            f"last set is {same}: relative difference from ours {result['relative_error']:.2g}",
            f"ratio {result['ratio']:.0f}, {min(ratios):.0f} to {max(ratios):.0f} in "
            f"{len(ratios)} rounds (target {TARGET}: {met}), "
            f"{result['ratio_with_terminal_set']:.0f} with our T_0 and checks counted",
        ]
    )
