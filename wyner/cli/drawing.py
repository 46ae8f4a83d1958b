"""The option ``--plot``: how a command draws what it shows."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.errors import UsageError, needs, writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def add_plot(place: "argparse._ActionsContainer", default: str) -> None:
    """Add ``--plot``, which draws what the command shows."""
    place.add_argument(
        "--plot",
        nargs="?",
        const="",
        metavar="F",
        help=f"draw it, as F.png, F.pdf or F.svg (default: {default})",
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a sweep's figure."""
    group = parser.add_argument_group(
        "figure",
        "The rows with 95 % intervals over the field with the most values. What does not stand on "
        "the axes makes a curve each.",
    )
    add_plot(group, "beside the rows")
    group.add_argument(
        "--y",
        metavar="COLUMN",
        action="append",
        help="default: bits_per_second; or state_cost, input_effort, 'NAME keys known', 'NAME "
        "messages read' (repeatable)",
    )


def plot_sweep(path: Path, args: argparse.Namespace, *, silent: bool = False) -> None:
    """Read the rows, choose the columns, draw."""
    drawable(args.plot or "rows.png")
    from wyner.drawing.rows import RATE, draw_rows, longest, ready

    rows, fields = ready(path)
    x = longest(rows, fields)
    ys: list[str] = args.y or [RATE]
    for name in ys:
        if name not in rows[0]:
            known = ", ".join(c for c in rows[0] if not c.endswith(("low", "high")))
            raise UsageError(f"--y: got {name!r}, expected one of: {known}")
    output = args.plot or str(path.with_suffix(".png"))
    plot(output, (6.4, 4.2), lambda f: draw_rows(f, rows, fields, x, ys), silent=silent)


def drawable(text: str) -> Path:
    """The file of a figure, by its name: to be asked before hours of work are drawn into it.

    Raises
    ------
    UsageError
        When matplotlib is missing, or the file's kind is none that can be drawn.
    """
    try:
        from wyner.drawing.style import KINDS
    except ImportError:
        raise UsageError(needs("--plot", "matplotlib")) from None
    path = Path(text)
    if path.suffix not in KINDS:
        raise UsageError(f"--plot: got {text!r}, expected a name that ends in {', '.join(KINDS)}")
    return path


def plot(
    text: str,
    size: tuple[float, float],
    draw: "Callable[[Figure], str]",
    *,
    silent: bool = False,
) -> None:
    """Draw a figure into the file of ``--plot`` and print its path.

    Parameters
    ----------
    text : str
        The file's name.
    size : tuple of float
        Inches.
    draw : callable
        Draws, and returns a note for the bottom of the figure.
    silent : bool
        The path goes to standard error: on standard output is one JSON object.

    Raises
    ------
    UsageError
        As `drawable`, and when the file cannot be written.
    """
    path = drawable(text)
    from wyner.drawing.style import drawing, save

    with drawing(size) as figure:
        figure.supxlabel(draw(figure), fontsize=6.5, color="0.35")
        with writing(f"--plot: {path}"):
            save(figure, path)
    print(path, file=sys.stderr if silent else sys.stdout)
