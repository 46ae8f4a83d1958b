"""The live screen: draws the board a few times a second and acts on keys."""

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import IO, Final

from rich.console import Console, ConsoleDimensions
from rich.live import Live
from rich.text import Text

from wyner.dashboard.keymap import Action, action_of
from wyner.dashboard.model import Board, reduce_all
from wyner.dashboard.screenshot import save
from wyner.dashboard.source import Source
from wyner.dashboard.terminal import BACKSPACES, ENTERS, ESCAPE, cbreak, hold_stderr
from wyner.dashboard.view import Wishes, screen

REFRESH_S: Final = 0.1
"""Time between two looks at keys and messages."""

REDRAW_NS: Final = 1_000_000_000
"""A screen without news is drawn again after so long, so that silence shows."""

NAME_LENGTH: Final = 32
"""Characters of a filter."""

Size = tuple[int, int]


class Ending(Enum):
    """How watching ended."""

    QUIT = "quit"
    FINISHED = "finished"
    INTERRUPTED = "interrupted"


class Watch:
    """The live screen's state: the board that grows, the one that is shown, and the wishes.

    It touches neither terminal nor clock, so a test can press keys and look at what is drawn.
    """

    def __init__(self, *, unicode: bool, folder: Path) -> None:
        self.board = Board()
        self.wishes = Wishes(unicode=unicode)
        self.quit = False
        self.saved: list[Path] = []
        self._folder = folder
        self._held: Board | None = None
        self._held_ns = 0
        self._dirty = True
        self._drawn: tuple[Size, int] = ((0, 0), 0)

    def take(self, source: Source) -> None:
        """Reduce what came; also while the view is frozen."""
        arrivals = source.drain()
        if arrivals or self.board.unreadable != source.garbage:
            self.board = reduce_all(self.board, arrivals)
            self.board = replace(self.board, unreadable=source.garbage)
            self._dirty = True

    def press(self, key: str, size: Size, now_ns: int) -> None:
        """Act on one key."""
        self._dirty = True
        self.wishes = replace(self.wishes, note="")
        if self.wishes.typing:
            self._type(key)
            return
        match action_of(key):
            case Action.QUIT:
                self.quit = True
            case Action.HELP:
                self.wishes = replace(self.wishes, help=not self.wishes.help)
            case Action.FREEZE:
                frozen = not self.wishes.frozen
                self._held = self.board if frozen else None
                self._held_ns = now_ns
                self.wishes = replace(self.wishes, frozen=frozen)
            case Action.FILTER:
                self.wishes = replace(self.wishes, typing=True, help=False, filter="")
            case Action.SAVE:
                self._save(size, now_ns)
            case None:
                if key == ESCAPE:
                    self.wishes = replace(self.wishes, filter="", help=False)

    def due(self, size: Size, now_ns: int) -> bool:
        """Whether the screen is worth drawing: news, a key, another size, or a second gone."""
        drawn_size, drawn_ns = self._drawn
        return self._dirty or size != drawn_size or now_ns - drawn_ns >= REDRAW_NS

    def draw(self, size: Size, now_ns: int) -> list[Text]:
        """The lines of the screen."""
        self._dirty = False
        self._drawn = (size, now_ns)
        return self._lines(size, now_ns)

    def _lines(self, size: Size, now_ns: int) -> list[Text]:
        shown, wishes = self.board, self.wishes
        if self._held is not None:
            shown, now_ns = self._held, self._held_ns
            wishes = replace(
                wishes,
                held_steps=_steps_between(shown, self.board),
            )
        return screen(shown, *size, wishes, now_ns)

    def _type(self, key: str) -> None:
        text = self.wishes.filter
        if key in ENTERS:
            self.wishes = replace(self.wishes, typing=False)
        elif key == ESCAPE:
            self.wishes = replace(self.wishes, typing=False, filter="")
        elif key in BACKSPACES:
            self.wishes = replace(self.wishes, filter=text[:-1])
        elif key.isprintable():
            self.wishes = replace(self.wishes, filter=(text + key)[:NAME_LENGTH])

    def _save(self, size: Size, now_ns: int) -> None:
        try:
            svg, text = save(self._lines(size, now_ns), size[0], self._folder)
        except OSError as error:
            note = f"not saved: {self._folder}: {error.strerror}"
        else:
            self.saved += [svg, text]
            note = f"saved {svg.name} and {text.name}"
        self.wishes = replace(self.wishes, note=note)


def run_dashboard(
    source: Source,
    *,
    until: Callable[[], bool],
    run_dir: Path | None = None,
    out: IO[str] | None = None,
    keyboard: int | None = None,
) -> Ending:
    """Show the live screen until ``q``, Ctrl-C, or ``until()``, which is asked ten times a second.

    Parameters
    ----------
    source : Source
        Where messages come from.
    until : callable
        Whether there is nothing more to watch.
    run_dir : Path, optional
        Where screenshots go; the current folder if not given.
    out : text file, optional
        A terminal; standard output if not given.
    keyboard : int, optional
        Descriptor of the terminal to read keys from; standard input if not given.

    Returns
    -------
    Ending
        How it ended. The terminal is as it was before, whatever happened; what was written to
        standard error meanwhile and the names of saved screens are printed there.
    """
    stream = out or sys.stdout
    console = Console(file=stream, force_terminal=True, highlight=False)
    watch = Watch(unicode=speaks_unicode(stream), folder=run_dir or Path())
    ending = Ending.FINISHED
    try:
        with (
            hold_stderr(),
            cbreak(keyboard) as keys,
            Live(
                console=console,
                screen=True,
                auto_refresh=False,
                redirect_stdout=False,
                redirect_stderr=False,
            ) as live,
        ):
            while not watch.quit:
                finished = until()
                size = _size(stream)
                watch.take(source)
                if watch.due(size, source.now_ns()):
                    console.size = ConsoleDimensions(*size)
                    lines = watch.draw(size, source.now_ns())
                    live.update(Text("\n").join(lines), refresh=True)
                if finished:
                    break
                for key in keys.read(REFRESH_S):
                    watch.press(key, size, source.now_ns())
            # Left as it is, a screen that grew while it was shown stays behind in some terminals.
            console.clear()
    except KeyboardInterrupt:
        ending = Ending.INTERRUPTED
        # A signal that came while the screen was being set up left nobody to take it down.
        console.set_alt_screen(False)
        console.show_cursor()
    finally:
        for path in watch.saved:
            print(f"saved {path}", file=sys.stderr)
        for line in source.problems():
            print(line, file=sys.stderr)
    return Ending.QUIT if watch.quit else ending


def has_screen(out: IO[str] | None = None) -> bool:
    """Whether the live screen can be shown: a terminal, and one that can move its cursor."""
    return (out or sys.stdout).isatty() and os.environ.get("TERM", "") not in ("", "dumb")


def speaks_unicode(stream: IO[str]) -> bool:
    """Whether a stream can carry the picture's characters."""
    try:
        "⣿▁─●…".encode(getattr(stream, "encoding", None) or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _steps_between(held: Board, board: Board) -> int | None:
    """Steps that the plant made since; None when its session is another one."""
    if board.plant is None:
        return 0
    if held.plant is None or held.plant.session != board.plant.session:
        return None
    return max(0, board.plant.k - held.plant.k)


def _size(stream: IO[str]) -> Size:
    try:
        columns, rows = os.get_terminal_size(stream.fileno())
    except OSError:
        return (80, 24)
    # A terminal that does not know its size says 0x0.
    return (columns, rows) if columns > 0 and rows > 0 else (80, 24)
