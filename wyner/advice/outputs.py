"""Whether a plant that is read through some states alone could carry keys."""

from dataclasses import dataclass
from typing import Final

from protocol.agreement import Gauge
from protocol.box_observer import Box, BoxObserver
from protocol.scenario import Scenario

BOUNDS: Final = 1e6
"""Half-width of the box before the first reading."""


@dataclass(frozen=True)
class OutputsVerdict:
    """What a box observer makes of a scenario's plant; inputs in the plant's units.

    Parameters
    ----------
    outputs : tuple of int
        The states that are read, from 1.
    radius : tuple of float, shape (n,)
        Half-widths of the box of a quiet loop.
    needed : float
        How far apart two inputs must be to be told apart in every case.
    possible : float
        How far apart they may be: for her within (alpha - 1) D_c, and within U.
    alpha : float
        From which on she finds inputs possible that are so far apart as is needed; infinite where
        U has no room for them.
    """

    outputs: tuple[int, ...]
    radius: tuple[float, ...]
    needed: float
    possible: float
    alpha: float

    @property
    def carries(self) -> bool:
        """Whether two inputs can be both."""
        return self.needed <= self.possible

    def line(self) -> str:
        """The verdict for people."""
        shown = ", ".join(f"x_{i}" for i in self.outputs)
        text = (
            f"read by {shown} alone: inputs {self.needed:.3g} apart are always told apart, up to "
            f"{self.possible:.3g} apart she finds both possible within U: "
        )
        if self.carries:
            return text + "it carries keys"
        known = ", ".join(f"{r:.3g}" for r in self.radius)
        text += f"no key is sure, as the state is known to no better than {known}"
        if self.alpha == float("inf"):
            return text
        return f"{text}; it would carry keys from alpha = {self.alpha:.3g} on"


def outputs_verdict(
    scenario: Scenario, outputs: tuple[int, ...], noise: tuple[float, ...]
) -> OutputsVerdict:
    """Whether the scenario's plant carries keys where only some states are read.

    Parameters
    ----------
    scenario : Scenario
        With one input, and boxes for D_c and U.
    outputs : tuple of int
        The states that are read, from 1.
    noise : tuple of float
        Half-width of the noise of each of them.

    Raises
    ------
    ValueError
        When the scenario has another form, or an output is none of its states.
    """
    D_c, U = scenario.defender.disturbance, scenario.control.inputs
    if scenario.m != 1 or D_c.half_widths is None or U.half_widths is None:
        raise ValueError("expected a plant of one input, with boxes for D_c and U")
    if not outputs or not all(1 <= i <= scenario.n for i in outputs):
        raise ValueError(f"got {list(outputs)}, expected states from 1 to {scenario.n}")
    C = tuple(tuple(float(j == i - 1) for j in range(scenario.n)) for i in outputs)
    bounds = (BOUNDS,) * scenario.n
    observer = BoxObserver(scenario.A, scenario.B, C, D_c.half_widths, noise, bounds)
    radius = observer.quiet()
    box = Box(tuple(-r for r in radius), radius)
    moved, blur = observer.needed(box, (1.0,))
    needed = min((b / a for a, b in zip(moved, blur, strict=True) if a > 0), default=float("inf"))
    push = Gauge.from_rows(*D_c.rows())([row[0] for row in scenario.B])
    room = (scenario.secrecy.alpha - 1) / push if push else float("inf")
    width = 2 * U.half_widths[0]
    alpha = 1 + needed * push if needed <= width else float("inf")
    return OutputsVerdict(outputs, radius, needed, min(room, width), alpha)


def outputs_of(scenario: Scenario) -> tuple[dict[int, float], bool]:
    """The states that the scenario reads, from 1, with their noise; and whether each is one state.

    Of a sum of states there is no verdict: :func:`outputs_verdict` asks about states.
    """
    observer = scenario.observer
    if observer is None:
        return {}, False
    read = {}
    for row, width in zip(observer.C, observer.noise, strict=True):
        places = [i for i, c in enumerate(row) if c]
        if len(places) != 1:
            return {}, False
        read[places[0] + 1] = width / abs(row[places[0]])
    return read, True
