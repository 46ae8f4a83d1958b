"""``wyner secret``: the first secret that both ends of a loop share."""

import argparse
from pathlib import Path

from runtime.errors import DONE, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write a new secret to F. Give a copy of it to each end, for its --secret; "
        "each takes it once, and its file then holds only the secret's name."
    )
    parser.add_argument("file", metavar="F", help="a file that is not there yet")


def run(args: argparse.Namespace) -> int:
    """Make it."""
    from runtime.keys.secret_file import SecretError, make_secret

    try:
        name = make_secret(Path(args.file))
    except SecretError as error:
        raise UsageError(str(error)) from None
    print(f"secret {name}: give a copy of {args.file} to each end")
    return DONE
