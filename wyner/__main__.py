"""The process of the command: its signals and its output, before the rest is loaded."""

import sys

from runtime.command import entered


def _load_and_run() -> int:
    from wyner.cli.main import main as command

    return command(sys.argv[1:])


def main() -> int:
    """Load the command and run it; returns the exit code."""
    return entered(_load_and_run)


if __name__ == "__main__":
    sys.exit(main())
