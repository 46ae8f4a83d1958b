"""The keys of the live screen, as a table: the app acts on it and the help is made from it."""

from dataclasses import dataclass
from enum import Enum
from typing import Final


class Action(Enum):
    """What a key asks for."""

    QUIT = "quit"
    HELP = "help"
    FREEZE = "freeze"


@dataclass(frozen=True, slots=True)
class Binding:
    """One row of the table: what is typed, how it is written, its short and its whole meaning."""

    character: str
    label: str
    action: Action
    short: str
    meaning: str


KEYS: Final[tuple[Binding, ...]] = (
    Binding("q", "q", Action.QUIT, "quit", "leave the dashboard"),
    Binding("?", "?", Action.HELP, "help", "show or hide this page"),
    Binding(" ", "Space", Action.FREEZE, "freeze", "hold the view; capture goes on and is counted"),
)


def action_of(character: str) -> Action | None:
    """The action bound to a character, if there is one."""
    return next((key.action for key in KEYS if key.character == character), None)
