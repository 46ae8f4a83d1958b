"""The process of the command: its signals and its output, before the rest is loaded."""

import sys

from runtime.command import entered
from runtime.private_arguments import hide_message


def _load_and_run() -> int:
    from wyner.cli.main import main as command

    return command(sys.argv[1:])


def main() -> int:
    """Load the command and run it; returns the exit code."""
    hide_message()
    return entered(_load_and_run)


if __name__ == "__main__":
    sys.exit(main())
