"""What every command shares: signals, output, and errors of one line each."""

import _thread
import argparse
import errno
import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Final

from protocol.errors import WynerError
from protocol.text import printable
from runtime.errors import FAILED, INTERRUPTED, USAGE, Failure, UsageError, in_a_line
from runtime.hanging import leave
from runtime.services import SERVICES

ENDING: Final = (signal.SIGTERM, signal.SIGHUP)


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line and exit code 2."""

    def error(self, message: str) -> None:  # type: ignore[override]
        """Raise instead of printing the whole usage."""
        raise UsageError(f"{message} (see {self.prog} --help)")


def carry_out(command: Callable[[], int]) -> int:
    """Parse a command line and do what it says; returns the exit code, and lets no traceback out.

    Set ``WYNER_TRACEBACK=1`` to see where an unexpected error came from.
    """
    try:
        code = command()
        sys.stdout.flush()  # here, where a full disk or a reader that went away is still told
        return code
    except (UsageError, Failure, WynerError) as error:
        problems = getattr(error, "problems", ())  # of a scenario, too
        for line in problems or [str(error)]:
            print(f"wyner: {printable(line)}", file=sys.stderr)
        return USAGE if problems else FAILED
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        _flush_or_drop_output()
        return FAILED
    except Exception as error:
        if os.environ.get("WYNER_TRACEBACK"):
            raise
        _flush_or_drop_output()
        print(f"wyner: {printable(in_a_line(error))}", file=sys.stderr)
        named = isinstance(error, OSError) and error.errno in (errno.ENAMETOOLONG, errno.ELOOP)
        return USAGE if named else FAILED


def entered(command: Callable[[], int]) -> int:
    """Run a process's command; returns the exit code.

    Being told to end, or losing the terminal, is Ctrl-C: whatever a command holds open it gives
    back, the screen above all. A service stops on these signals in its own way. Where something
    does not let go the process ends here.
    """
    return leave(_signalled(command))


_told_to_end = threading.Event()


def end_if_told() -> None:
    """Raise an interrupt again that a library caught where it came, for a loop that works long.

    Raises
    ------
    KeyboardInterrupt
        When this process was told to end.
    """
    if _told_to_end.is_set():
        raise KeyboardInterrupt


def _signalled(command: Callable[[], int]) -> int:
    over = False

    def interrupt(_signal: int, _frame: object) -> None:
        _told_to_end.set()
        if not over:
            raise KeyboardInterrupt

    try:
        for number in (signal.SIGINT, *ENDING):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
                signal.signal(number, interrupt)
        sys.unraisablehook = _once_more
        if isinstance(sys.stdout, io.TextIOWrapper):
            # a message may hold any character, and the terminal's encoding not all of them
            sys.stdout.reconfigure(errors="backslashreplace")
        return command()
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:  # all is given back: one more signal ends the interpreter without a word
        over = True
        for number in (signal.SIGINT, *ENDING):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)


AGAIN_S: Final = 0.02
"""Seconds after which an interrupt that could not be raised is raised again."""


def _once_more(unraisable: "sys.UnraisableHookArgs") -> None:
    """Raise an interrupt again that came where none can be raised, as in a finaliser.

    It is raised `AGAIN_S` later, from another thread: here it would be lost again.
    """
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        again = threading.Timer(AGAIN_S, _thread.interrupt_main)
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(unraisable)


def serve(name: str) -> int:
    """Run a service by its own command, with the arguments of this process."""

    def command() -> int:
        row = SERVICES[name]
        module = importlib.import_module(row.command)
        parser = Parser(prog=f"wyner {name}", description=row.summary)
        module.add_arguments(parser)
        return int(module.run(parser.parse_args()))

    return entered(lambda: carry_out(command))


def _flush_or_drop_output() -> None:
    """Write what is left, or else the interpreter tries again at its end, and complains."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
