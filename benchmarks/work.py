"""The bytecodes that an answer takes, in both of the automaton's states."""

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmarks.timing import WARM_UP, Life, LivingEnd

if TYPE_CHECKING:
    from types import FrameType

PUBLIC_WORK: Final = ("controller_service/laws/", "protocol/agreement.py")
"""What sees public numbers alone."""


def work(side: str, scenario: str, life: Life) -> dict[bool, Counter[int]]:
    """Bytecodes that each answer of an end takes, by whether a message symbol is carried.

    Left out is what sees public numbers alone, how much it does with them hangs on the numbers: the
    law, and the agreement test.
    """
    counts: dict[bool, Counter[int]] = {False: Counter(), True: Counter()}
    count = 0

    def trace(frame: "FrameType", event: str, _: object) -> Any:
        nonlocal count
        if event == "call":
            frame.f_trace_opcodes, frame.f_trace_lines = True, False
            return None if any(map(frame.f_code.co_filename.count, PUBLIC_WORK)) else trace
        count += event == "opcode" and not end.ports.left_ns
        return trace

    with tempfile.TemporaryDirectory() as folder:
        end = LivingEnd(side, scenario, Path(folder), life, again=True)
        for number, heard in enumerate(life.heard):
            if number <= WARM_UP * len(life.heard):  # tables are made, modules are loaded
                end.take(heard)
            else:
                carries, count = end.carries, 0
                before = sys.gettrace()
                sys.settrace(trace)
                answered = end.take(heard)
                sys.settrace(before)
                if answered:
                    counts[carries][count] += 1
            end.ports.mail.clear()
        end.close()
    return counts
