"""A watch over an end's turns: a call into a user's file that never returns ends the service.

A scheme, a law, a plant or an attack of a user's own is trusted code, and runs in the turn of the
end that asks it. While it does not return nothing else can be done there, no signal obeyed and no
message heard. So a thread of its own looks on, says in a line which call it is, and ends the
process: what a journal holds is as after a kill.
"""

import os
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Final

from runtime.errors import FAILED

TICK_S: Final = 1.0

TICKS: Final = 30
"""Looks in a row that find one turn under way. A process that was stopped meanwhile looks once."""

ROOMS: Final = frozenset(
    {
        *("attacker_service", "controller_service", "plant_service", "protocol", "runtime"),
        *("tap_service", "wyner"),
    }
)


class TurnWatch:
    """Looks at turns in a thread of its own until it is left.

    Parameters
    ----------
    module : str
        That turns are begun in: frames below its own are no part of a turn.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._number = 0
        self._under_way = False
        self._turns_thread = 0
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def begin(self) -> None:
        """A turn begins, on this thread."""
        self._number += 1
        self._turns_thread = threading.get_ident()
        self._under_way = True

    def over(self) -> None:
        """It has returned."""
        self._under_way = False

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._thread.join()

    def _look(self) -> None:
        seen, times = -1, 0
        while not self._left.wait(TICK_S):
            number, thread = self._number, self._turns_thread
            if not self._under_way or number != seen:
                seen, times = number, 0
                continue
            times += 1
            if times == TICKS:
                frame = sys._current_frames().get(thread)  # noqa: SLF001
                call = _call(frame, self._module)
                said = f"wyner: {call} has not returned for {TICKS * TICK_S:g} s"
                os.write(2, f"{said}; a file of one's own must return\n".encode())
                os._exit(FAILED)


def _call(frame: FrameType | None, module: str) -> str:
    """The call that a turn made out of the program's own rooms; else where it is."""
    where, found = frame, frame
    while frame is not None and frame.f_globals.get("__name__") != module:
        if str(frame.f_globals.get("__name__")).split(".")[0] not in ROOMS:
            found = frame  # the outermost within the turn
        frame = frame.f_back
    at = found or where
    if at is None:
        return "a turn"
    code = at.f_code
    return f"{Path(code.co_filename).name}, line {at.f_lineno}, in {code.co_name}"
