"""How a program ends: exit codes, and errors that are one line."""

import errno
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from protocol.errors import WynerError

DONE: Final = 0
FAILED: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130


class UsageError(Exception):
    """Bad usage or configuration, exit code 2; ``problems`` has one line for each wrong field."""

    def __init__(self, problems: Sequence[str] | str) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


class Failure(Exception):
    """Something that was asked for could not be done, exit code 1; the text is one line."""


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Within the block, the error of a missing, malformed or senseless field becomes one line.

    Set ``WYNER_TRACEBACK=1`` to see what it was.

    Raises
    ------
    UsageError
        In place of what a missing, malformed or senseless field raises.
    """
    try:
        yield
    except WynerError:  # its line is clear already
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        if os.environ.get("WYNER_TRACEBACK"):
            raise
        why = f"{type(error).__name__}: {error}".split("\n")[0]
        raise UsageError(f"{what}: not as this program writes it ({why})") from None


FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Errors of a disk, which no other option would mend."""


@contextmanager
def writing(what: str) -> Iterator[None]:
    """Within the block, a file that cannot be written becomes one line about the option ``what``.

    Raises
    ------
    UsageError
        When the file that was named cannot be written.
    Failure
        When the disk is full or broken.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        text = f"{what}: cannot be written: {error.strerror or error}"
        raise (Failure if error.errno in FULL else UsageError)(text) from None


def needs(what: str, package: str) -> str:
    """One line: ``what`` asks for a package that is not there, and how this very Python gets it."""
    return f"{what}: needs {package}: {sys.executable} -m pip install {package}"


UNIX: Final = ("fcntl", "resource", "termios", "pty")
"""Modules of Python's library that other systems lack."""


def in_a_line(error: Exception) -> str:
    """What is said of an error where there is one line for it."""
    if isinstance(error, UsageError | Failure | WynerError):
        return str(error).replace("\n", "; ")
    if isinstance(error, ModuleNotFoundError) and error.name in UNIX:
        return (
            f"this system has no {error.name}: the commands need Linux; the library "
            "(from wyner import design, run, eavesdrop) does not"
        )
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror
    return " ".join(f"unexpected {type(error).__name__}: {error}".split())
