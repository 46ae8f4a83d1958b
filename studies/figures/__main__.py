"""``python -m studies.figures``: draw the figures of docs/ from their data."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from runtime.command import Parser, carry_out
from runtime.errors import DONE, Failure, UsageError, needs


def build_parser() -> argparse.ArgumentParser:
    """The program's options."""
    parser = Parser(
        prog="python -m studies.figures",
        description="Draw the figures of docs/, all or those named, as SVG and PNG.",
    )
    parser.add_argument("name", nargs="*", metavar="NAME", help="which (default: all)")
    parser.add_argument(
        "--measure",
        action="store_true",
        help="make their data anew before; to those of a secrecy-* figure and of undetected, whose "
        "runs take long, only what they lack or other code made is measured",
    )
    parser.add_argument("--data", metavar="D", help="folder of the data (default: docs/data)")
    parser.add_argument("--output", metavar="D", help="folder to draw in (default: docs/figures)")
    return parser


def run(args: argparse.Namespace) -> int:
    """Measure where asked, and draw."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UsageError(needs("figures", "matplotlib")) from None
    from studies import DATA, FIGURES_FOLDER
    from studies.figures import FIGURES, FigureError, draw

    unknown = [name for name in args.name if name not in FIGURES]
    if unknown:
        raise UsageError(f"figures: got {unknown[0]!r}, expected {', '.join(FIGURES)}")
    names = args.name or list(FIGURES)
    data = Path(args.data) if args.data else DATA
    if args.measure:
        from studies.measurements import MEASUREMENTS

        for file in dict.fromkeys(file for name in names for file in FIGURES[name].data):
            print(f"measuring {file} ...", file=sys.stderr)
            MEASUREMENTS[file].measure(data / f"{file}.csv")
    try:
        for name in names:
            for path in draw(name, data, Path(args.output) if args.output else FIGURES_FOLDER):
                print(path)
    except FigureError as error:
        raise Failure(str(error)) from None
    except OSError as error:
        raise Failure(f"{error.filename}: cannot be written: {error.strerror}") from None
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit code."""
    return carry_out(lambda: run(build_parser().parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(main())
