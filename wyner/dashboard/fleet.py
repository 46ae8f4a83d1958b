"""Many loops in one table: the newest status of each, the ones in trouble first."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from io import StringIO
from typing import TYPE_CHECKING, Final

from pydantic import ValidationError
from rich.console import Console, Group, RenderableType
from rich.live import Live

from protocol.messages import ControllerStatus, Message, PlantStatus, TapStatus
from protocol.topics import every_loop
from runtime.fleet import LARGEST_FLEET
from runtime.inbox import Inbox
from wyner.dashboard.keymap import Action, action_of
from wyner.dashboard.model import TAPS_KEPT
from wyner.dashboard.parts import WIDE, Column, fitting, line, table
from wyner.dashboard.source import WAITING_AT_MOST
from wyner.dashboard.terminal import cbreak
from wyner.dashboard.text import drawn

if TYPE_CHECKING:
    from runtime.bus import Bus

SILENT_S: Final = 5.0
"""Seconds after which a loop without a status counts as silent."""

LATELY_S: Final = 10.0
"""Seconds over which missed steps trouble the order of the table."""

REFRESH_S: Final = 1.0
PRINT_S: Final = 10.0


@dataclass(slots=True)
class LoopRow:
    """What is known of one loop."""

    loop: str
    plant: PlantStatus | None = None
    controller: ControllerStatus | None = None
    taps: dict[str, TapStatus] = field(default_factory=dict)
    heard_s: float = 0.0
    marks: list[tuple[float, int]] = field(default_factory=list)

    def note(self, status: Message, now_s: float) -> None:
        """Take in a status."""
        if isinstance(status, PlantStatus):
            if self.plant is not None and status.missed < self.plant.missed:
                self.marks.clear()  # it counts from 0 again
            self.plant, self.heard_s = status, now_s
            self.marks.append((now_s, status.missed))
            while len(self.marks) > 2 and self.marks[1][0] <= now_s - LATELY_S:
                self.marks.pop(0)
        elif isinstance(status, ControllerStatus):
            self.controller = status
        elif isinstance(status, TapStatus) and (
            status.name in self.taps or len(self.taps) < TAPS_KEPT
        ):
            self.taps[status.name] = status

    @property
    def lately(self) -> int:
        """Steps missed lately."""
        return self.marks[-1][1] - self.marks[0][1] if self.marks else 0

    def state(self, now_s: float) -> str:
        """The plant's phase, or that nothing is heard of it."""
        if self.plant is None:
            return "no plant"
        if now_s - self.heard_s > SILENT_S and self.plant.phase != "stopped":
            return "silent"
        return self.plant.phase

    def waiting(self) -> str:
        """How many messages wait at the controller."""
        return "" if self.controller is None else str(self.controller.queue)

    def claim(self) -> str:
        """The surest eavesdropper's claim, beside the truth where the plant has told it."""
        surest = max(self.taps.values(), key=lambda tap: tap.confidence, default=None)
        if surest is None:
            return ""
        truth = self.plant.last_message if self.plant is not None else ""
        verdict = ""
        if truth and surest.message:
            verdict = ", right" if surest.message == truth else ", wrong"
        lost = f", {surest.lost} lost" if surest.lost else ""
        bits = max(tap.key_bits_held for tap in self.taps.values())
        lost += f", {bits} bits of keys held" if bits > 0 else ""
        return f"{drawn(surest.name)} is {100 * surest.confidence:.0f} % sure{verdict}{lost}"


_Seen = tuple[LoopRow, float]


def _of_plant(told: Callable[[PlantStatus], str]) -> Callable[[_Seen], str]:
    return lambda of: "" if of[0].plant is None else told(of[0].plant)


COLUMNS: Final[tuple[Column[_Seen], ...]] = (
    Column("state", 10, 0, lambda of: of[0].state(of[1])),
    Column("steps", 8, 3, _of_plant(lambda plant: str(plant.k))),
    Column("missed", 7, 2, _of_plant(lambda plant: str(plant.missed))),
    Column("of them lately", 14, 5, lambda of: "" if of[0].plant is None else str(of[0].lately)),
    Column("steps/s", 7, 6, _of_plant(lambda plant: f"{plant.rate_hz:.1f}")),
    Column("key symbols", 11, 7, _of_plant(lambda plant: str(plant.agreements))),
    Column("messages", 8, 4, _of_plant(lambda plant: str(plant.messages))),
    Column("keys made", 9, 8, _of_plant(lambda plant: str(plant.keys_made))),
    Column(
        "waiting", 7, 10, lambda of: "" if of[0].controller is None else f"{of[0].controller.queue}"
    ),
    Column("the surest eavesdropper", WIDE, 1, lambda of: of[0].claim()),
)
"""Left to right; the loop's name stands before them."""

NAME: Final = 14
"""Cells of a loop's name."""

PRINTED: Final = 240
"""Cells of a line that is printed and not shown."""


class FleetTable:
    """The newest statuses of the loops that were heard, of `LARGEST_FLEET` at most.

    Callbacks put into an inbox; :meth:`take` parses, on the caller's thread.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self._rows: dict[str, LoopRow] = {}
        self._arrived: Inbox[tuple[type[Message], str, bytes]] = Inbox(WAITING_AT_MOST)

    def attach(self, management: "Bus", adversary: "Bus") -> None:
        """Listen to the statuses of every loop."""
        watched = (
            (management, PlantStatus),
            (management, ControllerStatus),
            (adversary, TapStatus),
        )
        for bus, kind in watched:
            bus.subscribe(every_loop(kind), self._arrive(kind))

    def _arrive(self, kind: type[Message]) -> Callable[[str, bytes, int], None]:
        return lambda key, payload, _t: self._arrived.put((kind, key, payload), len(payload))

    def take(self, now_s: float) -> None:
        """Take in what has come."""
        for _ in range(len(self._arrived)):
            kind, key, payload = self._arrived.get(0.0)
            loop = key.split("/")[2]
            try:
                status = kind.model_validate_json(payload)
            except ValidationError:
                self.malformed += 1
                continue
            if loop in self._rows or len(self._rows) < LARGEST_FLEET:
                self._rows.setdefault(loop, LoopRow(loop)).note(status, now_s)

    def shown(self, now_s: float, width: int = PRINTED, most: int | None = None) -> Group:
        """A sum, the table, and how many loops it leaves out; ``most`` lines in all."""
        rows = sorted(self._rows.values(), key=lambda row: _order(row, now_s))
        running = sum(row.state(now_s) == "running" for row in rows)
        missed = sum(row.plant.missed for row in rows if row.plant is not None)
        lately = sum(row.lately for row in rows)
        total = (
            f"{running} of {len(rows)} loops run, {missed} steps missed, {lately} of them lately"
        )
        if self.malformed:
            total += f"; {self.malformed} messages were malformed"
        if self._arrived.dropped:
            total += f"; {self._arrived.dropped} came faster than they were read"
        room = len(rows) if most is None else most - 3
        hidden = max(0, len(rows) - room)
        columns = fitting(COLUMNS, width - NAME - 1)
        seen = [(row.loop, (row, now_s)) for row in rows[: len(rows) - hidden]]
        told = [line(f"... and {hidden} more that are well or better")] if hidden else []
        return Group(line(total), table("loop", NAME, columns, seen), *told)


def _order(row: LoopRow, now_s: float) -> tuple[bool, int, str]:
    return (row.state(now_s) == "running", -row.lately, row.loop)


def watch(
    fleet: FleetTable, until: Callable[[], bool], *, screen: bool, keyboard: int | None = None
) -> None:
    """Show the table until told to stop: on the screen, or printed every few seconds.

    ``keyboard`` is the terminal from which q leaves the screen; standard input if not given.
    """
    if screen:
        _on_screen(fleet, until, keyboard)
        return
    next_s = 0.0
    while not until():
        now_s = time.monotonic()
        fleet.take(now_s)
        if now_s >= next_s:
            next_s = now_s + PRINT_S
            _print(fleet.shown(now_s))
        time.sleep(0.1)
    fleet.take(time.monotonic())
    _print(fleet.shown(time.monotonic()))


def plain(shown: RenderableType) -> list[str]:
    """The lines of what is shown, without colours, whatever they are printed to."""
    console = Console(file=StringIO(), width=PRINTED, color_system=None, record=True)
    console.print(shown)
    return [text.rstrip() for text in console.export_text().splitlines()]


def _print(shown: RenderableType) -> None:
    sys.stdout.write("\n".join([*plain(shown), "", ""]))
    sys.stdout.flush()


def _on_screen(fleet: FleetTable, until: Callable[[], bool], keyboard: int | None) -> None:
    console = Console()
    foot = line("q  quit   `wyner dashboard --loop NAME` opens one")
    with cbreak(keyboard) as keys, Live(console=console, screen=True, auto_refresh=False) as live:
        while not until():
            now_s = time.monotonic()
            fleet.take(now_s)
            width, height = console.size
            live.update(Group(fleet.shown(now_s, width, height - 1), foot), refresh=True)
            if any(action_of(key) is Action.QUIT for key in keys.read(REFRESH_S)):
                return
