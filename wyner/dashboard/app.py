"""The live screen: draws the state four times a second and acts on keys."""

import os
import sys
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import IO, Final

from rich.console import Console, ConsoleDimensions, RenderableType
from rich.live import Live

from wyner.dashboard.model import LoopState, reduce
from wyner.dashboard.source import BusSource
from wyner.dashboard.story import MOMENTS, Caption, next_moment
from wyner.dashboard.terminal import ESCAPE, cbreak, hold_stderr
from wyner.dashboard.view import ViewState, screen

REFRESH_S: Final = 0.25
"""Time between two pictures; a key is answered at once."""

STOPPING: Final = "The run is over, and its services stop. Eve reads the rest of its recording."
GO_ON: Final = "Space goes on.  q leaves."
LEAVE: Final = "The run is over.  Any key leaves; ? helps to read it first."
"""What the last line says while a caption is shown."""

Size = tuple[int, int]


class Ending(Enum):
    """How watching ended."""

    QUIT = "quit"
    FINISHED = "finished"
    INTERRUPTED = "interrupted"


class LiveScreen:
    """The live screen's state: the state that grows, the one that is shown, and the view.

    It touches neither terminal nor clock, so a test can press keys and look at what is drawn.
    With ``story`` it pauses at the moments of `wyner.dashboard.story`; what comes meanwhile is
    reduced all the same, and later moments wait for their turn.
    """

    def __init__(self, *, story: bool = False, title: str = "") -> None:
        self.state = LoopState()
        self.view = ViewState(title=title)
        self.quit = False
        self._told = set() if story else set(range(len(MOMENTS)))
        self._moments: deque[tuple[Caption, LoopState, int]] = deque()
        self._ending: Caption = ()
        self._held: LoopState | None = None
        self._held_ns = 0

    def take(self, source: BusSource) -> None:
        """Reduce what came; also while the view is frozen."""
        for arrival in source.drain():
            self.state = reduce(self.state, arrival)
            if (found := next_moment(self.state, self._told)) is not None:
                place, caption = found
                self._told.add(place)
                self._moments.append((caption, self.state, arrival.t_ns))
                self._show_moment()

    def _show_moment(self) -> None:
        """Hold the view at the next moment of the story, unless one is shown already."""
        if self._moments and not self.view.caption and self._held is None:
            caption, self._held, self._held_ns = self._moments.popleft()
            self.view = replace(self.view, caption=caption, press=GO_ON, frozen=True)

    def end(self, lines: Sequence[str]) -> None:
        """The run is over: show its last lines, and what they say."""
        self._ending = ("What this run shows", *lines)
        if not self.view.caption:
            self._release()

    def _release(self) -> None:
        """Leave a pause or a freeze; the next moment or the end of the run follows."""
        self._held = None
        self.view = replace(self.view, caption=(), press="", frozen=False)
        self._show_moment()
        if self._ending and not self.view.caption:
            # No service publishes any more, and that is no silence to be told.
            self._held, self._held_ns = self.state, max(self.state.seen.values(), default=0)
            self.view = replace(self.view, caption=self._ending, press=LEAVE)

    def press(self, key: str, now_ns: int) -> None:
        """Act on one key."""
        self.view = replace(self.view, note="")
        if key == "?":
            self.view = replace(self.view, help=not self.view.help)
        elif key == "q" or self.view.press == LEAVE:
            self.quit = True
        elif key == ESCAPE:
            self.view = replace(self.view, help=False)
        elif key == " " and self.view.frozen:
            self._release()
        elif key == " ":
            self._held, self._held_ns = self.state, now_ns
            self.view = replace(self.view, frozen=True)

    def draw(self, size: Size, now_ns: int) -> RenderableType:
        """The whole screen."""
        if self._held is None:
            return screen(self.state, *size, self.view, now_ns)
        view = replace(self.view, held_steps=_steps_between(self._held, self.state))
        return screen(self._held, *size, view, self._held_ns)


def run_dashboard(
    source: BusSource,
    *,
    until: Callable[[], bool],
    story: bool = False,
    conclude: Callable[[], Sequence[str]] | None = None,
    title: str = "",
) -> Ending:
    """Show the live screen until ``q``, Ctrl-C, or ``until()``, which is asked at every picture.

    Parameters
    ----------
    source : BusSource
        Where messages come from.
    until : callable
        Whether there is nothing more to watch.
    story : bool, optional
        Pause at the moments of `wyner.dashboard.story`.
    conclude : callable, optional
        Called once ``until()`` holds; what it returns is shown on the last screen, which then stays
        until a key is pressed. Without it, or without a keyboard, the screen closes at once.
    title : str, optional
        What the first line begins with; the program's name if not given.

    Returns
    -------
    Ending
        How it ended; a last screen that was left has come to its end. The terminal is as it was
        before, whatever happened; what was written to standard error meanwhile is repeated there.
    """
    console = Console(force_terminal=True, highlight=False)
    watch = LiveScreen(story=story, title=title)
    over = False
    ending = Ending.FINISHED
    try:
        with (
            hold_stderr(),
            cbreak() as keys,
            Live(
                console=console,
                screen=True,
                auto_refresh=False,
                redirect_stdout=False,
                redirect_stderr=False,
            ) as live,
        ):

            def show() -> None:
                size = _size()
                console.size = ConsoleDimensions(*size)
                live.update(watch.draw(size, source.now_ns()), refresh=True)

            while not watch.quit:
                finished = over or until()
                watch.take(source)
                show()
                if finished and not over:
                    over = True
                    if conclude is None or not keys.connected:
                        break
                    watch.view = replace(watch.view, note=STOPPING)
                    show()
                    lines = conclude()
                    watch.take(source)
                    watch.view = replace(watch.view, note="")
                    watch.end(lines)
                    continue
                for key in keys.read(REFRESH_S):
                    watch.press(key, source.now_ns())
            # Left as it is, a screen that grew while it was shown stays behind in some terminals.
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


def _steps_between(held: LoopState, state: LoopState) -> int | None:
    """Steps that the plant made since; None when its session is another one."""
    if state.plant is None:
        return 0
    if held.plant is None or held.plant.session != state.plant.session:
        return None
    return max(0, state.plant.step.k - held.plant.step.k)


def _size() -> Size:
    try:
        columns, rows = os.get_terminal_size(sys.stdout.fileno())
    except OSError:
        return (80, 24)
    # A terminal that does not know its size says 0x0.
    return (columns, rows) if columns > 0 and rows > 0 else (80, 24)
