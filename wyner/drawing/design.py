"""A design in one figure: its sets with a run through them, how far its candidates lie apart."""

from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from wyner.advice.why import APART, closest_predictions
from wyner.drawing.axes import hull
from wyner.drawing.style import COLOURS

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design
    from protocol.scenario import Scenario

MARGIN: Final = 0.5
"""Free room around the run and T_0, as a share of their extent: the largest sets go beyond it."""

STEPS: Final = 200
SEED: Final = 1

Array = npt.NDArray[np.float64]


def draw_design(figure: Figure, scenario: "Scenario", design: "Design", law: "CandidateLaw") -> str:
    """Left the sets and a run, right the distance of the closest predictions; returns the note."""
    from wyner.simulate.engine import simulate_runs

    run = simulate_runs(scenario, law, seed=SEED, runs=range(1), steps=STEPS, record=True)
    assert run.x is not None
    assert run.candidates is not None
    left, right = figure.subplots(1, 2)
    x = run.x[:, :, 0]
    N = design.horizon
    shown = sorted({0, *(i for i in (1, 2, 5, 10, 20, 50, 100, 200) if i < N), N})
    for i in shown:
        H, h = (np.asarray(v) for v in design.set(i))
        ring = shadow(H, h)
        rest = f"T_1 to T_{N}: those in sight" if i == 1 else None
        left.fill(*ring, alpha=0.05, color="0.3", lw=0)
        left.plot(*ring, color="0.6" if i else COLOURS[0], lw=1, label=rest if i else "T_0")
    if x.shape[1] > 1:
        left.plot(x[:, 0], x[:, 1], color=COLOURS[2], marker=".", ms=3, lw=0.7, label="a run")
        left.set_ylabel("$x_2$")
    else:
        left.plot(x[:, 0], np.zeros(len(x)), color=COLOURS[2], marker=".", ms=3, label="a run")
    ring = shadow(*(np.asarray(v) for v in design.set(0)))
    for axis, values, set_limits in ((0, ring[0], left.set_xlim), (1, ring[1], left.set_ylim)):
        seen = x[:, axis] if axis < x.shape[1] else np.zeros(1)
        low, high = min(values.min(), seen.min()), max(values.max(), seen.max())
        set_limits(low - MARGIN * (high - low), high + MARGIN * (high - low))
    left.set_xlabel("$x_1$")
    left.legend(fontsize=8)
    left.set_title("Sets, and a run through them", fontsize=10)
    apart = closest_predictions(scenario, run.candidates)[:, 0]
    agreed = (run.symbol[:, 0] >= 0) & (run.largest[:, 0] <= scenario.secrecy.alpha)
    k = np.arange(STEPS)
    right.plot(k, apart, color="0.7", lw=0.8, marker=".", ms=3, label="step")
    right.plot(
        k[agreed], apart[agreed], ls="none", marker="o", color=COLOURS[2], label="could agree"
    )
    right.axhline(APART, color=COLOURS[1], lw=1, ls="--", label="from here on each step agrees")
    right.set_xlabel("step")
    right.set_ylabel("closest two predictions, in half-widths of D_c")
    right.set_ylim(0, 1.3 * max(APART, apart.max()))  # the legend stands above what is drawn
    right.legend(fontsize=8, loc="upper right")
    right.set_title("How far apart the candidates lie", fontsize=10)
    return f"{scenario.name}, law {scenario.control.law}: one run of {STEPS} steps, seed {SEED}"


def shadow(H: Array, h: Array) -> tuple[Array, Array]:
    """The outline of { v : H v <= h } on the first two axes, closed; of one state, a strip."""
    from protocol.convex import corners

    if H.shape[1] == 1:
        ends = corners(H, h)[:, 0]
        low, high = float(ends.min()), float(ends.max())
        return np.array([low, high, high, low, low]), np.array([-1.0, -1, 1, 1, -1])
    ring = hull(corners(H, h)[:, :2])
    return ring[:, 0], ring[:, 1]
