"""The live screen: draws the state a few times a second and acts on keys."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from enum import Enum
from typing import IO, Final

from rich.console import Console, ConsoleDimensions, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.text import Text

from wyner.dashboard.keymap import Action, action_of
from wyner.dashboard.model import State, reduce
from wyner.dashboard.source import Source
from wyner.dashboard.story import MOMENTS, Moment, next_moment
from wyner.dashboard.terminal import ESCAPE, cbreak, hold_stderr
from wyner.dashboard.view import ViewState, screen

REFRESH_S: Final = 0.1
"""Time between two looks at keys and messages."""

FRAME_NS: Final = 200_000_000
"""Time between two pictures of what came; a key is answered at once."""

REDRAW_NS: Final = 1_000_000_000
"""A screen without news is drawn again after so long, so that silence shows."""

STOPPING: Final = "The run is over; its services stop. She thinks to the end of what she heard."
GO_ON: Final = "Space goes on.  q leaves."
LEAVE: Final = "The run is over.  Any key leaves; ? helps to read it first."
"""What the last line says while a caption is shown."""

Size = tuple[int, int]


class Ending(Enum):
    """How watching ended."""

    QUIT = "quit"
    FINISHED = "finished"
    INTERRUPTED = "interrupted"


class Watch:
    """The live screen's state: the state that grows, the one that is shown, and the view.

    It touches neither terminal nor clock, so a test can press keys and look at what is drawn.
    With ``story`` it pauses at the moments of `wyner.dashboard.story`; what comes meanwhile is
    reduced all the same, and later moments wait for their turn.
    """

    def __init__(self, *, story: bool = False) -> None:
        self.state = State()
        self._told = set() if story else set(range(len(MOMENTS)))
        self._moments: deque[tuple[Moment, State, int]] = deque()
        self._ending: tuple[str, ...] = ()
        self.view = ViewState()
        self.quit = False
        self._held: State | None = None
        self._held_ns = 0
        self._dirty, self._fresh = True, False
        self._drawn: tuple[Size, int] = ((0, 0), 0)

    def take(self, source: Source) -> None:
        """Reduce what came; also while the view is frozen."""
        arrivals = source.drain()
        if arrivals or self.state.unreadable != source.malformed:
            for arrival in arrivals:
                self.state = reduce(self.state, arrival)
                self._look_for_moments(arrival.t_ns)
            self.state = replace(self.state, unreadable=source.malformed)
            self._fresh = True

    def _look_for_moments(self, t_ns: int) -> None:
        found = next_moment(self.state, self._told)
        if found is not None:
            place, moment = found
            self._told.add(place)
            self._dirty = True
            self._moments.append((moment, self.state, t_ns))
            self._show_moment()

    def _show_moment(self) -> None:
        """Hold the view at the next moment of the story, unless one is shown already."""
        if not self._moments or self.view.caption or self._held is not None:
            return
        moment, self._held, self._held_ns = self._moments.popleft()
        self.view = replace(
            self.view, caption=moment.caption, press=GO_ON, frozen=True, step=moment.step
        )

    def end(self, lines: Sequence[str]) -> None:
        """The run is over: show its last lines, and what they say."""
        self._ending = ("What this run shows", *lines)
        self._dirty = True
        if not self.view.caption:
            self._release()

    def _release(self) -> None:
        """Leave a pause or a freeze; the next moment or the end of the run follows."""
        self._held = None
        self.view = replace(self.view, caption=(), press="", frozen=False, step=None)
        self._show_moment()
        if self._ending and not self.view.caption:
            # Nobody speaks any more, and that is no silence to be told.
            self._held, self._held_ns = self.state, self.state.last_seen_ns
            self.view = replace(self.view, caption=self._ending, press=LEAVE)

    def press(self, key: str, now_ns: int) -> None:
        """Act on one key."""
        self._dirty = True
        self.view = replace(self.view, note="")
        action = action_of(key)
        if self.view.press == LEAVE and action is not Action.HELP:
            self.quit = True
            return
        match action:
            case Action.QUIT:
                self.quit = True
            case Action.HELP:
                self.view = replace(self.view, help=not self.view.help)
            case Action.FREEZE if self.view.frozen:
                self._release()
            case Action.FREEZE:
                self._held, self._held_ns = self.state, now_ns
                self.view = replace(self.view, frozen=True)
            case None:
                if key == ESCAPE:
                    self.view = replace(self.view, help=False)

    def due(self, size: Size, now_ns: int) -> bool:
        """Whether the screen is worth drawing: news, a key, another size, or a second gone."""
        drawn_size, drawn_ns = self._drawn
        waited_ns = now_ns - drawn_ns
        return (
            self._dirty
            or size != drawn_size
            or waited_ns >= (FRAME_NS if self._fresh else REDRAW_NS)
        )

    def draw(self, size: Size, now_ns: int) -> RenderableType:
        """The whole screen."""
        self._dirty = self._fresh = False
        self._drawn = (size, now_ns)
        shown, view = self.state, self.view
        if self._held is not None:
            shown, now_ns = self._held, self._held_ns
            view = replace(view, held_steps=_steps_between(shown, self.state))
        return screen(shown, *size, view, now_ns)


class Stage:
    """One full screen for several runs: between them it is not left, and the shell stays behind it.

    Made by `one_stage`.
    """

    def __init__(self, stream: IO[str]) -> None:
        self.console = _KeptScreen(file=stream, force_terminal=True, highlight=False)

    def card(self, *lines: str) -> None:
        """A title and its lines, until the next run has something to show."""
        self.console.clear()
        self.console.print()
        for line in lines:
            self.console.print(Padding(Text(line), (0, 1)))


class _KeptScreen(Console):
    """A console whose full screen is entered once, and left by whoever opened it."""

    kept = True

    def set_alt_screen(self, enable: bool = True) -> bool:
        if self.kept and (self.is_alt_screen or not enable):
            return enable
        return super().set_alt_screen(enable)


@contextmanager
def one_stage(out: IO[str] | None = None) -> Iterator[Stage]:
    """A full screen for the runs within the block; the terminal is given back whatever happens.

    What is written to standard error meanwhile is repeated after it.
    """
    stage = Stage(out or sys.stdout)
    with hold_stderr(), cbreak():
        try:
            stage.console.set_alt_screen(True)
            stage.console.show_cursor(False)
            yield stage
        finally:
            stage.console.kept = False
            stage.console.clear()
            stage.console.set_alt_screen(False)
            stage.console.show_cursor(True)


def run_dashboard(
    source: Source,
    *,
    until: Callable[[], bool],
    out: IO[str] | None = None,
    keyboard: int | None = None,
    story: bool = False,
    conclude: Callable[[], Sequence[str]] | None = None,
    title: str = "",
    stage: Stage | None = None,
) -> Ending:
    """Show the live screen until ``q``, Ctrl-C, or ``until()``, which is asked ten times a second.

    Parameters
    ----------
    source : Source
        Where messages come from.
    until : callable
        Whether there is nothing more to watch.
    out : text file, optional
        A terminal; standard output if not given.
    keyboard : int, optional
        Descriptor of the terminal to read keys from; standard input if not given.
    story : bool, optional
        Pause at the moments of `wyner.dashboard.story`.
    conclude : callable, optional
        Called once ``until()`` holds; what it returns is shown on the last screen, which then stays
        until a key is pressed. Without it, or without a keyboard, the screen closes at once.
    title : str, optional
        What the first line begins with; the program's name if not given.
    stage : Stage, optional
        A full screen that is open already, and stays open with the last picture on it.

    Returns
    -------
    Ending
        How it ended; a last screen that was left has come to its end. The terminal is as it was
        before, whatever happened; what was written to standard error meanwhile is repeated there.
    """
    stream = out or sys.stdout
    console = (
        Console(file=stream, force_terminal=True, highlight=False)
        if stage is None
        else stage.console
    )
    watch = Watch(story=story)
    watch.view = replace(watch.view, title=title)
    over = False
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
                finished = over or until()
                size = _size(stream)
                watch.take(source)
                if watch.due(size, source.now_ns()):
                    console.size = ConsoleDimensions(*size)
                    live.update(watch.draw(size, source.now_ns()), refresh=True)
                if finished and not over:
                    over = True
                    watch.view = replace(watch.view, note=STOPPING)
                    live.update(watch.draw(size, source.now_ns()), refresh=True)
                    if conclude is None or not keys.connected:
                        break
                    lines = conclude()
                    watch.take(source)
                    watch.view = replace(watch.view, note="")
                    watch.end(lines)
                    continue
                for key in keys.read(REFRESH_S):
                    watch.press(key, source.now_ns())
            # Left as it is, a screen that grew while it was shown stays behind in some terminals.
            if stage is None:
                console.clear()
    except KeyboardInterrupt:
        ending = Ending.INTERRUPTED
        # A signal that came while the screen was being set up left nobody to take it down.
        console.set_alt_screen(False)
        console.show_cursor()
    finally:
        for line in source.problems():
            print(line, file=sys.stderr)
    return Ending.QUIT if watch.quit and not over else ending


def has_screen(out: IO[str] | None = None) -> bool:
    """Whether the live screen can be shown.

    It takes a terminal that can move its cursor, and an encoding that has the screen's characters.
    """
    stream = out or sys.stdout
    if not stream.isatty() or os.environ.get("TERM", "") in ("", "dumb"):
        return False
    try:
        "⣿▁─●…".encode(getattr(stream, "encoding", None) or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _steps_between(held: State, state: State) -> int | None:
    """Steps that the plant made since; None when its session is another one."""
    if state.plant is None:
        return 0
    if held.plant is None or held.plant.session != state.plant.session:
        return None
    return max(0, state.plant.k - held.plant.k)


def _size(stream: IO[str]) -> Size:
    try:
        columns, rows = os.get_terminal_size(stream.fileno())
    except OSError:
        return (80, 24)
    # A terminal that does not know its size says 0x0.
    return (columns, rows) if columns > 0 and rows > 0 else (80, 24)
