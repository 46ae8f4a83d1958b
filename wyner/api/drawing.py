"""The paper's figures of one's own systems and runs, on axes of one's own."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from protocol.agreement import NO_SYMBOL
from protocol.convex import corners
from wyner.api.simulation import Simulated, rate_against_alpha
from wyner.api.systems import System

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_sets(
    system: System,
    axes: "Axes",
    indices: Sequence[int] | None = None,
    runs: Simulated | None = None,
) -> None:
    """Draw some T_i of a plant in the plane, and the trajectories of ``runs`` through them."""
    from wyner.drawing.axes import draw_sets as draw

    chosen = indices or sorted({0, 1, 2, 4, 8} & set(range(system.horizon + 1)))
    draw(axes, {i: system.corners(i) for i in chosen}, None if runs is None else runs.x)


def draw_agreement(runs: Simulated, axes: "Axes", step: int | None = None, run: int = 0) -> None:
    """Draw one step as Fig. 4 does: both reachable sets of both parties, and where x(k+1) fell.

    By default the first step on which a key symbol was agreed; of plants with more than two states
    the first two.
    """
    from wyner.drawing.axes import draw_agreement as draw

    agreed = np.flatnonzero(runs.key[_run(runs, run)] != NO_SYMBOL)
    k = step if step is not None else int(agreed[0]) if len(agreed) else 0
    if not 0 <= k < runs.steps:
        raise ValueError(f"step: got {k}, expected 0 to {runs.steps - 1}")
    scenario = runs.system.scenario
    x, offers = runs.x[run, k], runs.candidates[run, k]
    predictions = x @ np.array(scenario.A).T + offers @ np.array(scenario.B).T
    D_c, D_e = (
        corners(*(np.array(a) for a in disturbance.rows()))
        for disturbance in (scenario.defender.disturbance, scenario.eavesdropper_set)
    )
    draw(axes, predictions, runs.x[run, k + 1], D_c, D_e)


def draw_states(runs: Simulated, axes: "Axes", run: int = 0) -> None:
    """Draw the states of a run over time, with a mark on every step that agreed a key symbol."""
    agreed = np.flatnonzero(runs.key[_run(runs, run)] != NO_SYMBOL)
    x = runs.x[run]
    time_s = runs.system.scenario.plant.period_s * np.arange(len(x))
    for i in range(x.shape[1]):
        axes.plot(time_s, x[:, i], lw=1, label=f"$x_{i + 1}$")
    axes.plot(time_s[agreed + 1], np.zeros(len(agreed)), "|", color="k", ms=8, label="key agreed")
    axes.set_xlabel("time (s)")
    axes.set_ylabel("state")
    axes.legend(fontsize="small")


def _run(runs: Simulated, run: int) -> int:
    if not 0 <= run < runs.count:
        raise ValueError(f"run: got {run}, expected 0 to {runs.count - 1}")
    return run


def draw_rate(runs: Simulated, axes: "Axes", alphas: ArrayLike, label: str | None = None) -> None:
    """Draw the rate against alpha with its 95 % band (the paper's Fig. 7)."""
    values = np.atleast_1d(np.asarray(alphas, dtype=float))
    rates = rate_against_alpha(runs, values)
    name = label or runs.system.scenario.name
    (line,) = axes.plot(values, [r.value for r in rates], lw=1.4, label=name)
    low, high = [r.low for r in rates], [r.high for r in rates]
    axes.fill_between(values, low, high, color=line.get_color(), alpha=0.2)
    axes.set_xlabel(r"$\alpha$")
    axes.set_ylabel("message rate (bit/s), which is not secrecy")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
