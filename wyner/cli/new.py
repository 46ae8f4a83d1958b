"""``wyner new``: a scenario file of one's own, with comments."""

import argparse
import re
from pathlib import Path
from re import fullmatch
from typing import Final

from runtime.errors import DONE, UsageError, writing

EXAMPLE: Final = ("[[0.0, 1.0], [0.0, 0.0]]", "[[0.0], [1.0]]", 0.1)
"""A mass that is pushed: A, B and the period where none are given; continuous."""

NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


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


def run(args: argparse.Namespace) -> int:
    """Write the file, once it has been read back."""
    from protocol.scenario.reading import LARGEST_NUMBER
    from wyner.fit.first_scenario import HORIZONS, first_scenario

    given = (args.A, args.B, args.period)
    if any(v is not None for v in given) and None in given:
        raise UsageError("expected --A, --B and --period together, or none of them")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", args.name):
        raise UsageError(
            f"NAME: got {args.name!r}, expected a letter or digit, and up to 63 letters, digits, "
            "dots, dashes, underscores"
        )
    for option in ("period", "input"):
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
    path = Path(f"{args.name}.toml")
    text, starts = first_scenario(args.name, A, B, period, [args.input] * len(B[0]))
    if path.exists():
        raise UsageError(f"{path}: is there already, expected another name")
    with writing(str(path)), path.open("x", encoding="utf-8") as file:
        file.write(text)
    says = "says what it gives" if starts else "says why it has no terminal set yet"
    print(f"{path}: {_sizes(A, B)}; `wyner design {path}` {says}")
    return DONE


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _matrix(option: str, text: str) -> list[list[float]]:
    """A matrix as a list of rows, as MATLAB writes it, or as NumPy prints it."""
    from protocol.scenario.reading import LARGEST_NUMBER

    bare = re.sub(r"\]\s*,?\s*\[", ";", text).strip("[] \t\n").removesuffix(";")
    rows = [re.split(r"\s*,\s*|\s+", row.strip()) for row in re.split(r"[;\n]", bare)]
    for i, row in enumerate(rows, 1):
        for entry in row:
            if entry and not fullmatch(NUMBER, entry):
                raise UsageError(f"{option}: row {i}: {_short(entry)!r} is no number")
    whole = len({len(row) for row in rows}) == 1 and text.count("[") == text.count("]")
    matrix = [[float(entry or "nan") for entry in row] for row in rows]
    small = all(abs(v) <= LARGEST_NUMBER for row in matrix for v in row)
    if not (whole and small):
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


def _sizes(A: list[list[float]], B: list[list[float]]) -> str:
    return f"{_counted(len(A), 'state')}, {_counted(len(B[0]), 'input')}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
