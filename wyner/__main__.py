"""The process of the command: its signals and its output, before the rest is loaded."""

import io
import signal
import sys

ENDING = (signal.SIGTERM, signal.SIGHUP)


def _interrupt(_signal: int, _frame: object) -> None:
    raise KeyboardInterrupt


def main(*first: str) -> int:
    """Load the command and run it, with ``first`` before its arguments; returns the exit code.

    Being told to end, or losing the terminal, is Ctrl-C: whatever a command holds open it gives
    back, the screen above all. A service stops on these signals in its own way.
    """
    for number in ENDING:
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup has it ignored
            signal.signal(number, _interrupt)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # a message may hold any character, and the terminal's encoding not all of them
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        from wyner.cli.main import main as command

        return command([*first, *sys.argv[1:]])
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
