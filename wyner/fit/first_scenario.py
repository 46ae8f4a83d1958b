"""A first scenario of a plant whose A and B are known: weights, widths and a gain that start."""

import tomllib
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from controller_service.sets.design import stated_start
from controller_service.sets.gains import find_gain
from controller_service.sets.terminal import SynthesisError
from protocol.arrays import Array
from protocol.scenario import Scenario, parse_scenario

Matrix = list[list[float]]

HORIZONS: Final = {
    (1, 1): 50,
    (1, 2): 50,
    (2, 1): 50,
    (2, 2): 50,
    (3, 1): 30,
    (3, 2): 10,
    (4, 1): 8,
    (4, 2): 4,
}
"""By states and inputs: sets that a design computes in seconds. No other size has a design."""

SHARES: Final = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Half-width of D, as a share of what the largest inputs move each state by in a step: the first
for which there is a terminal set."""

WEIGHTS: Final = (1.0, 0.1, 0.01, 10.0)
"""Weights of the inputs, each in units of its bound, in the order in which they are tried. Beside
them each state has a weight of one in units of its reach."""

REACH_STEPS: Final = 10
"""A state's reach is as far as the inputs take it in so many steps."""

WIDER: Final = 1.2
"""D_c over D, the ratio of the paper's example."""


def first_scenario(
    name: str,
    A: Matrix,
    B: Matrix,
    period_s: float,
    bounds: Sequence[float],
    widths: Sequence[float] | None = None,
    origin: str = "",
) -> tuple[str, bool]:
    """The text of a scenario's file, and whether there is a terminal set for it.

    Parameters
    ----------
    name : str
    A, B : list of rows
    period_s : float
    bounds : sequence of float
        Largest value of each input.
    widths : sequence of float, optional
        Half-widths of D by state. Where none are given, the widest that have a terminal set.
    origin : str, optional
        Lines of comment that say where A, B and D come from.
    """
    pushes = pushed(A, B, bounds)
    weights = state_weights(pushes)

    def written(D: Sequence[float], gain: str) -> str:
        """The file, each field with a line that says why."""
        return TEMPLATE.format(
            name=name,
            origin="".join(f"# {line}\n" for line in origin.splitlines()),
            A=A,
            B=B,
            period_s=f"{period_s:g}",
            start=[0.0] * len(A),
            D=_list(D),
            D_c=_list([WIDER * w for w in D]),
            weights=_list(weights),
            horizon=HORIZONS[len(A), len(bounds)],
            gain=gain,
            U=_list(bounds),
        )

    def regulated(D: Sequence[float], weight: float) -> str:
        inputs = [weight / bound**2 for bound in bounds]
        gain = BY_WEIGHTS.format(next_state=_list(weights), input=_list(inputs))
        return written(D, gain)

    def candidates() -> Iterator[str]:
        """First a regulator's weights, for each width of D; then a gain, for the widest D."""
        for D in tried:
            for weight in WEIGHTS:
                yield regulated(D, weight)
        for D in tried:
            found = find_gain(_parsed(regulated(D, WEIGHTS[0])), shares=(1.0,))
            if found is not None:
                yield written(D, BY_GAIN.format(gain=found.written(), decay=found.decay))

    tried = [widths] if widths is not None else list(widths_of(pushes))
    first = ""
    for text in candidates():
        first = first or text
        if _starts(text):
            return text, True
    return first, False


def pushed(A: Matrix, B: Matrix, bounds: Sequence[float]) -> Array:
    """How far the largest inputs push each state k steps later, shape (REACH_STEPS, n).

    In other units of a state its column alone changes, by their ratio. A state that no input moves
    is counted in what it takes of it to push another as far as the inputs do.
    """
    M = np.array(A)
    push = np.array(B) * np.array(bounds)
    out = []
    for _ in range(REACH_STEPS):
        out.append(np.abs(push).sum(axis=1))
        push = M @ push
    rows = np.array(out)
    for j in np.flatnonzero(~rows.any(axis=0)):
        column = np.abs(M[:, j])
        moves = rows[0][column > 0] / column[column > 0]
        rows[:, j] = min(moves[moves > 0], default=max(bounds))
    return rows


def state_weights(pushes: Array) -> list[float]:
    """One over the square of each state's reach."""
    return [float(v) for v in pushes.sum(axis=0) ** -2.0]


def widths_of(pushes: Array) -> Iterator[list[float]]:
    """Half-widths of D to be tried, the widest first: shares of the first push of each state."""
    first = [float(next(v for v in column if v > 0)) for column in pushes.T]
    for share in SHARES:
        yield [share * push for push in first]


def _starts(text: str) -> bool:
    """Whether the scenario has a terminal set, so that a design can begin."""
    try:
        stated_start(_parsed(text))
    except (SynthesisError, NotImplementedError, ValueError):
        return False
    return True


def _parsed(text: str) -> Scenario:
    return parse_scenario(tomllib.loads(text), "a first scenario")


def _list(values: Sequence[float]) -> str:
    return str([float(f"{v:.6g}") for v in values])


BY_WEIGHTS: Final = """\
[control.regulator]              # weights of u = K x near the origin; a larger input weight makes
next_state = {next_state:<19} # a softer K, a wider T_0, and more room between the candidates
input = {input}
"""

BY_GAIN: Final = """\
# u = K x near the origin. Plain weights gave no terminal set; this is a regulator's gain that was
# made to decay by {decay:g} a step at least (docs/concepts.md).
gain = {gain}
"""

TEMPLATE: Final = """\
# {name}: a scenario of wyner. `python -m tools.scenario_reference` prints every field.
{origin}#   wyner design {name}.toml     its sets, its rate, and why it is what it is
#   wyner up --scenario {name}.toml --pace x10
name = "{name}"
description = ""

[plant]                          # x+ = A x + B u + d, every period_s seconds
A = {A}
B = {B}
period_s = {period_s}
initial_state = {start}

[plant.disturbance]              # D, what the simulated plant suffers, in units of the state
kind = "uniform"                 # or corners, truncated-gaussian, gaussian, constant, sinusoid
half_widths = {D}

[defender.disturbance]           # D_c contains D; both ends know it, Eve does not
half_widths = {D_c}

[control]
law = "sustained"                # or paper (quiet inside T_0), packed (predictions kept apart)
horizon = {horizon:<22} # sets T_1 to T_N: more states to start from, more time to compute

{gain}
[control.inputs]                 # U: no input leaves it
half_widths = {U}

[[control.costs]]                # candidate 0 goes home fast; each state counts in units of
next_state = {weights:<19} # what the inputs move it by in ten steps
input = 0.0

[[control.costs]]                # candidate 1 spares the input
next_state = 0.0
input = 1.0

[secrecy]
alpha = 8.0                      # D_e = alpha D_c, the set that Eve is said to know
scheme = "switched"              # the paper's; or pipelined, or your own: FILE.py:CLASS
"""
