"""``wyner knowledge``: write what a scenario's eavesdropper knows, for a tap kept apart from it."""

import argparse
from pathlib import Path

from runtime.errors import DONE, Failure
from runtime.files import PUBLIC_FILE, write_atomically


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write, as JSON, what the paper's eavesdropper knows of a scenario: f_c and "
        "D_e, and neither D_c nor alpha. A tap on a machine of its own needs this file and no "
        "scenario (wyner tap --knowledge FILE)."
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="file or shipped name")
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="file to write (default: standard output)"
    )


def run(args: argparse.Namespace) -> int:
    """Read the scenario and write its public part."""
    from runtime.scenario_file import scenario_of

    text = scenario_of(args.scenario).knowledge().model_dump_json(indent=2) + "\n"
    if args.output is None:
        print(text, end="")
        return DONE
    try:
        write_atomically(args.output, text.encode(), PUBLIC_FILE)
    except OSError as error:
        raise Failure(f"--output: {args.output}: cannot be written: {error.strerror}") from None
    return DONE
