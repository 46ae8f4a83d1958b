"""``wyner new``: a scenario file of one's own, with comments."""

import argparse
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from re import fullmatch
from typing import TYPE_CHECKING, Any, Final

from runtime.errors import DONE, Failure, UsageError

if TYPE_CHECKING:
    from protocol.arrays import Array
    from protocol.scenario import Scenario

EXAMPLE: Final = ("[[0.0, 1.0], [0.0, 0.0]]", "[[0.0], [1.0]]", 0.1)
"""A mass that is pushed: A, B and the period where none are given; continuous."""

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

NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
ROW: Final = rf"{NUMBER}(?:\s*,\s*{NUMBER}|\s+{NUMBER})*"

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write NAME.toml from a plant's matrices: discrete ones, or continuous ones "
        "that are sampled here with a zero-order hold. 1 to 4 states and 1 or 2 inputs have a "
        "design. Matrices are written as lists of rows or as MATLAB writes them. Without matrices "
        "it is a mass that is pushed, to be changed by hand."
    )
    parser.add_argument("name", metavar="NAME", help="letters, digits, dots, dashes, underscores")
    parser.add_argument(
        "--A", metavar="ROWS", help='such as "[[1, 0.1], [0, 1]]" or "[1 0.1; 0 1]"'
    )
    parser.add_argument("--B", metavar="ROWS", help='such as "[[0], [0.1]]" or "[0; 0.1]"')
    parser.add_argument("--period", type=float, metavar="S", help="seconds to a step")
    parser.add_argument(
        "--continuous", action="store_true", help="A and B are of dx/dt = A x + B u"
    )
    parser.add_argument(
        "--input", type=float, default=1.0, metavar="V", help="bound of each input (default 1)"
    )
    parser.add_argument(
        "--disturbance",
        type=float,
        metavar="V",
        help="half-width of D in each state (default: a twentieth of what an input does in a "
        "step, or less where that leaves no terminal set)",
    )
    parser.add_argument("--output", metavar="F", help="default: NAME.toml here")


def run(args: argparse.Namespace) -> int:
    """Write the file, once it has been read back."""
    from protocol.scenario import ScenarioError
    from protocol.scenario.reading import LARGEST_NUMBER

    given = (args.A, args.B, args.period)
    if any(v is not None for v in given) and None in given:
        raise UsageError("expected --A, --B and --period together, or none of them")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", args.name):
        raise UsageError(
            f"NAME: got {args.name!r}, expected a letter or digit, and up to 63 letters, digits, "
            "dots, dashes, underscores"
        )
    for option in ("period", "input", "disturbance"):
        value = getattr(args, option)
        if value is not None and not 0 < value <= LARGEST_NUMBER:
            raise UsageError(
                f"--{option}: got {value:g}, expected more than 0 and at most {LARGEST_NUMBER:g}"
            )
    example = args.A is None
    A, B = _matrix("--A", args.A or EXAMPLE[0]), _matrix("--B", args.B or EXAMPLE[1])
    period = args.period or EXAMPLE[2]
    if len(A) != len(A[0]) or len(A) != len(B):
        raise UsageError(
            f"--A, --B: got {len(A)} x {len(A[0])} and {len(B)} x {len(B[0])}, expected n x n and "
            "n x m"
        )
    if (len(A), len(B[0])) not in HORIZONS:
        raise UsageError(
            f"--A, --B: got {_sizes(A, B)}, expected 1 to 4 states and 1 or 2 inputs: more have no "
            "sets here; a law of your own may bring its own (docs/guides.md, A control law of your "
            "own)"
        )
    if args.continuous or example:
        A, B = sampled(A, B, period)
        if not all(abs(v) <= LARGEST_NUMBER for row in (*A, *B) for v in row):
            raise UsageError(
                f"--A, --B: sampled over {period:g} s they hold numbers beyond {LARGEST_NUMBER:g}"
            )
    path = Path(args.output or f"{args.name}.toml")
    try:
        text, starts = _first_that_starts(args, A, B, period, path)
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UsageError(f"{path}: is there already, expected a new file (--output)") from None
    except OSError as error:
        raise Failure(f"{path}: cannot be written: {error.strerror}") from None
    says = "says what it gives" if starts else "says why it has no terminal set yet"
    print(f"{path}: {_sizes(A, B)}; `wyner design {path}` {says}")
    return DONE


def _first_that_starts(
    args: argparse.Namespace,
    A: list[list[float]],
    B: list[list[float]],
    period_s: float,
    path: Path,
) -> tuple[str, bool]:
    """The file's text, and whether there is a terminal set for it.

    First a regulator's weights are tried for each width of D; then, for the widest D that has one,
    a gain.
    """
    from controller_service.sets.gains import find_gain

    pushes = pushed(A, B, args.input)
    weights = state_weights(pushes)
    m = len(B[0])

    def written(widths: list[float], gain: str) -> str:
        return scenario_text(args.name, A, B, period_s, args.input, widths, weights, gain)

    def regulator(weight: float) -> str:
        inputs = [weight / args.input**2] * m
        return BY_WEIGHTS.format(next_state=_list(weights), input=_list(inputs))

    all_widths = list(widths_of(pushes, args.disturbance))
    first = written(all_widths[0], regulator(WEIGHTS[0]))
    for widths in all_widths:
        for weight in WEIGHTS:
            text = written(widths, regulator(weight))
            if _starts(text, path):
                return text, True
    for widths in all_widths:
        found = find_gain(_parsed(written(widths, regulator(1.0)), path), shares=(1.0,))
        if found is not None:
            text = written(widths, BY_GAIN.format(gain=found.written(), decay=found.decay))
            if _starts(text, path):
                return text, True
    return first, False


def pushed(A: list[list[float]], B: list[list[float]], bound: float) -> "Array":
    """How far the largest inputs push each state k steps later, shape (REACH_STEPS, n).

    In other units of a state its column alone changes, by their ratio. A state that no input moves
    is counted in what it takes of it to push another as far as the inputs do.
    """
    import numpy as np

    M = np.array(A)
    push = np.array(B) * bound
    out = []
    for _ in range(REACH_STEPS):
        out.append(np.abs(push).sum(axis=1))
        push = M @ push
    rows = np.array(out)
    for j in np.flatnonzero(~rows.any(axis=0)):
        column = np.abs(M[:, j])
        moves = rows[0][column > 0] / column[column > 0]
        rows[:, j] = min(moves[moves > 0], default=bound)
    return rows


def state_weights(pushes: "Array") -> list[float]:
    """One over the square of each state's reach."""
    return [float(v) for v in pushes.sum(axis=0) ** -2.0]


def widths_of(pushes: "Array", disturbance: float | None) -> Iterator[list[float]]:
    """Half-widths of D to be tried, the widest first: shares of the first push of each state."""
    if disturbance is not None:
        yield [disturbance] * pushes.shape[1]
        return
    first = [float(next(v for v in column if v > 0)) for column in pushes.T]
    for share in SHARES:
        yield [share * push for push in first]


def _starts(text: str, path: Path) -> bool:
    """Whether the scenario has a terminal set, so that a design can begin."""
    from controller_service.sets.design import stated_start
    from controller_service.sets.terminal import SynthesisError

    scenario = _parsed(text, path)
    try:
        stated_start(scenario)
    except (SynthesisError, NotImplementedError, ValueError):
        return False
    return True


def _parsed(text: str, path: Path) -> "Scenario":
    from protocol.scenario import parse_scenario

    return parse_scenario(tomllib.loads(text), str(path))


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _matrix(option: str, text: str) -> list[list[float]]:
    """A matrix as a list of rows, as MATLAB writes it, or as NumPy prints it."""
    from protocol.scenario.reading import LARGEST_NUMBER

    inner = re.sub(r"^\s*\[(.*)\]\s*$", r"\1", text, flags=re.DOTALL).strip()
    if inner.startswith("["):
        inner = re.sub(r"\]\s*,?\s*\[", ";", inner.removeprefix("[").removesuffix("]"))
    rows = [row.strip() for row in re.split(r"[;\n]", inner.strip().removesuffix(";"))]
    matrix = [[float(v) for v in re.split(r"[\s,]+", row)] for row in rows if fullmatch(ROW, row)]
    whole = len(matrix) == len(rows) and text.count("[") == text.count("]")
    small = all(abs(v) <= LARGEST_NUMBER for row in matrix for v in row)
    entries = [(i, v) for i, row in enumerate(rows, 1) for v in re.split(r"[\s,]+", row) if v]
    no_number = next(((i, v) for i, v in entries if not fullmatch(NUMBER, v)), None)
    if no_number is not None and not set(no_number[1]) & set("[];"):
        raise UsageError(f"{option}: row {no_number[0]}: {_short(no_number[1])!r} is no number")
    if not (whole and small and len({len(row) for row in matrix}) == 1):
        raise UsageError(
            f"{option}: got {_short(text)!r}, expected rows of one length, such as "
            f"[[1, 0.1], [0, 1]] or [1 0.1; 0 1], of numbers up to {LARGEST_NUMBER:g}"
        )
    return matrix


def sampled(
    A: list[list[float]], B: list[list[float]], period_s: float
) -> tuple[list[list[float]], list[list[float]]]:
    """Zero-order hold of dx/dt = A x + B u: the exponential of [[A, B], [0, 0]] over a period."""
    import numpy as np
    from scipy.linalg import expm

    n, m = len(A), len(B[0])
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    with np.errstate(all="ignore"):  # what is no number afterwards is refused
        step = expm(block * period_s)
    return step[:n, :n].tolist(), step[:n, n:].tolist()


def scenario_text(
    name: str,
    A: list[list[float]],
    B: list[list[float]],
    period_s: float,
    bound: float,
    widths: list[float],
    weights: list[float],
    gain: str,
) -> str:
    """The file, each field with a line that says why."""
    n, m = len(A), len(B[0])
    values: dict[str, Any] = {
        "name": name,
        "A": _rows(A),
        "B": _rows(B),
        "period_s": f"{period_s:g}",
        "start": _list([0.0] * n),
        "D": _list(widths),
        "D_c": _list([WIDER * w for w in widths]),
        "weights": _list(weights),
        "horizon": HORIZONS[n, m],
        "gain": gain,
        "U": _list([bound] * m),
    }
    return TEMPLATE.format(**values)


def _sizes(A: list[list[float]], B: list[list[float]]) -> str:
    return f"{_counted(len(A), 'state')}, {_counted(len(B[0]), 'input')}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def _list(values: list[float]) -> str:
    return "[" + ", ".join(f"{float(f'{v:.6g}')!r}" for v in values) + "]"


def _rows(matrix: list[list[float]]) -> str:
    return (
        "[" + ", ".join("[" + ", ".join(repr(float(v)) for v in row) + "]" for row in matrix) + "]"
    )


BY_WEIGHTS: Final = """\
[control.regulator]              # weights of u = K x near the origin; a larger input weight makes
next_state = {next_state:<19} # a softer K, a wider T_0, and more room between the candidates
input = {input}
"""

BY_GAIN: Final = """\
# u = K x near the origin. Plain weights gave no terminal set; this is a regulator's gain that was
# made to decay by {decay:g} a step at least (docs/control.md).
gain = {gain}
"""

TEMPLATE: Final = """\
# {name}: a scenario of wyner. docs/scenario-reference.md has every field.
#   wyner design {name}.toml     its sets, its rate, and why it is what it is
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

[defender.disturbance]           # D_c contains D; both ends know it, she does not
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
alpha = 8.0                      # D_e = alpha D_c, the set that she is said to know
scheme = "switched"              # the paper's; or pipelined, or your own: FILE.py:CLASS
"""
