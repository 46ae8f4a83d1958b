"""Two live loops beside each other, of which one stands still while the other one runs.

Rounds of whole runs differ by a tenth and more: a machine has quick minutes and slow ones. Turns of
a second share them out evenly.
"""

import math
import os
import re
import signal
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

from benchmarks.loop import ServiceProcess, running
from protocol.statistics import normal_mean
from runtime.errors import Failure
from runtime.recording import parts_of
from runtime.run_folder import CONTROLLER_TRACE

ENDLESS: Final = 10**7
"""Steps of a loop that is stopped before."""

WARM_UP_S: Final = 3.0

BLOCK: Final = 8
"""Turns of each loop that are one run of the statistics: at their edges steps are counted to a line
of a trace that is still to be written."""

TAIL: Final = 8192


class Loop:
    """One of the two: it stands still but for its turns.

    Parameters
    ----------
    services : iterable of ServiceProcess
    folder : Path
        Of the run.
    """

    def __init__(self, services: Iterable[ServiceProcess], folder: Path) -> None:
        self._folder = folder
        self._pids = [pid for service in services for pid in _family(service.process.pid)]
        self.seconds = 0.0
        self.send(signal.SIGSTOP)

    def send(self, which: signal.Signals) -> None:
        """Send a signal to every process of the loop that is there."""
        for pid in self._pids:
            with suppress(ProcessLookupError):
                os.kill(pid, which)

    def turn(self, seconds: float) -> None:
        """Let it run for so long."""
        began = time.monotonic()
        self.send(signal.SIGCONT)
        time.sleep(seconds)
        self.send(signal.SIGSTOP)
        self.seconds += time.monotonic() - began

    def steps(self) -> int:
        """The newest step of the controller's trace.

        Raises
        ------
        runtime.errors.Failure
            When there is none.
        """
        for part in reversed(parts_of(self._folder / CONTROLLER_TRACE)):
            with part.open("rb") as trace:
                trace.seek(max(trace.seek(0, os.SEEK_END) - TAIL, 0))
                seen = re.findall(rb'"k":(\d+)', trace.read())
            if seen:
                return int(seen[-1])
        raise Failure(f"{self._folder / CONTROLLER_TRACE}: no step was recorded")


def _family(pid: int) -> list[int]:
    """A process and all that it has started."""
    found = [pid]
    for thread in Path(f"/proc/{pid}/task").iterdir():
        for child in (thread / "children").read_text().split():
            found += _family(int(child))
    return found


def in_turn(
    scenarios: Mapping[str, Callable[[Path], Path]],
    *,
    blocks: int,
    seconds: float,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """The speed of two loops in lock-step, by turns.

    Parameters
    ----------
    scenarios : mapping
        Name of each loop, and what writes its scenario into a folder.
    blocks : int
        Of `BLOCK` turns of each loop.
    seconds : float
        Of a turn.
    progress : callable, optional
        Told in a line how each block went.

    Returns
    -------
    dict
        ``steps_per_second`` (by loop), ``ratio`` (of the second to the first: the geometric mean
        over blocks), ``low`` and ``high``, its 95 % interval with blocks as the unit, ``ratios``.

    Raises
    ------
    runtime.errors.Failure
        When a process fails, or a loop stands still.
    """
    say = progress or (lambda _line: None)
    with tempfile.TemporaryDirectory(prefix="wyner-bench-") as name, ExitStack() as stack:
        loops: dict[str, Loop] = {}
        for loop, written in scenarios.items():
            folder = Path(name) / loop
            folder.mkdir()
            services = stack.enter_context(running(written(folder), folder, ENDLESS))
            time.sleep(WARM_UP_S)
            loops[loop] = Loop(services.values(), folder)
            stack.callback(loops[loop].send, signal.SIGCONT)  # before they are asked to end
        begun = before = {loop: (it.steps(), it.seconds) for loop, it in loops.items()}
        logs: list[float] = []
        for block in range(blocks):
            for turn in range(BLOCK):
                order = list(loops.values())
                for it in order if turn % 2 == 0 else order[::-1]:
                    it.turn(seconds)
            now = {loop: (it.steps(), it.seconds) for loop, it in loops.items()}
            first, second = _rates(before, now).values()
            if not min(first, second) > 0:
                raise Failure(f"a loop made no step in {BLOCK} turns of {seconds:g} s")
            logs.append(math.log(second / first))
            before = now
            say(f"turns {block + 1} of {blocks}: {first:.0f} and {second:.0f} steps/s")
    mean = normal_mean(sum(logs), sum(log * log for log in logs), len(logs))
    return {
        "steps_per_second": _rates(begun, now),
        "ratio": math.exp(mean.value),
        "low": math.exp(mean.low),
        "high": math.exp(mean.high),
        "ratios": [math.exp(log) for log in logs],
    }


def _rates(
    before: Mapping[str, tuple[int, float]], now: Mapping[str, tuple[int, float]]
) -> dict[str, float]:
    """Steps a second of each loop, by steps and seconds of its turns."""
    return {loop: (now[loop][0] - k) / (now[loop][1] - s) for loop, (k, s) in before.items()}
