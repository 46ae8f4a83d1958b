"""Keys from a terminal: cbreak mode, select, and the old mode back whatever happens."""

import contextlib
import io
import os
import re
import select
import sys
import termios
import tty
from collections.abc import Iterator
from typing import Final

ESCAPE: Final = "\x1b"

HELD_CHARACTERS: Final = 16_384
"""Newest characters of standard error that are repeated after the screen closed."""

_READ_BYTES: Final = 256


class Keyboard:
    """Reads what was typed, without waiting for a line; made by `cbreak`."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    @property
    def connected(self) -> bool:
        """Whether keys can come."""
        return self._descriptor is not None

    def read(self, timeout_s: float) -> list[str]:
        """Characters typed within ``timeout_s`` seconds, at once when there are some.

        Without a keyboard this only waits. After the end of input there is no keyboard any more.
        """
        if self._descriptor is None:
            select.select([], [], [], timeout_s)
            return []
        ready, _, _ = select.select([self._descriptor], [], [], timeout_s)
        if not ready:
            return []
        data = os.read(self._descriptor, _READ_BYTES)
        if not data:
            self._descriptor = None
        return split_keys(data.decode("utf-8", "replace"))


_SEQUENCE: Final = re.compile("\x1b[\\[O][^@-~]*[@-~]?")
"""What a terminal sends for an arrow and the like."""


def split_keys(text: str) -> list[str]:
    """The single keys in what one read gave; sequences that begin with Escape are swallowed."""
    return list(_SEQUENCE.sub("", text))


@contextlib.contextmanager
def cbreak(descriptor: int | None = None) -> Iterator[Keyboard]:
    """A keyboard on a descriptor (standard input if not given), restored at the end.

    Where the descriptor is no terminal the keyboard is silent, and nothing is changed.
    """
    if descriptor is None:
        try:
            descriptor = sys.stdin.fileno()
        except (AttributeError, OSError, ValueError):
            descriptor = -1
    if descriptor < 0 or not os.isatty(descriptor):
        yield Keyboard(None)
        return
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        held = termios.tcgetattr(descriptor)
        # Ctrl-Z would leave the shell with a screen that is not its own.
        held[6][termios.VSUSP] = bytes([os.fpathconf(descriptor, "PC_VDISABLE") & 0xFF])
        termios.tcsetattr(descriptor, termios.TCSANOW, held)
        yield Keyboard(descriptor)
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


@contextlib.contextmanager
def hold_stderr() -> Iterator[None]:
    """Keep what Python writes to standard error, and repeat the newest of it at the end.

    Without this a warning would be drawn over the screen and be gone with it.
    """
    held = io.StringIO()
    try:
        with contextlib.redirect_stderr(held):
            yield
    finally:
        text = held.getvalue()
        if len(text) > HELD_CHARACTERS:
            text = "(earlier lines are left out)\n" + text[-HELD_CHARACTERS:].partition("\n")[2]
        sys.stderr.write(text)
