"""The process beside the mirror: reads the capture behind it, at its own pace.

The capture on disk is the queue between the two, so nothing is lost when this process is slow and
the mirror never waits for it. It rests in proportion to its work, so that it takes a bounded share
of a core; where it falls further behind than the capture keeps, the reader counts what is missing.
"""

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from pydantic_core import to_json

from protocol.knowledge import Knowledge
from runtime.child import ignore_signals, kill_after, limit_memory, line_of_child
from runtime.logs import RateLimitedLog, logger
from runtime.recording import Bounds
from runtime.run_folder import CAPTURE
from tap_service.capture.reading import CaptureError, CaptureReader
from tap_service.capture.recording import RotatingLog
from tap_service.listening import Listeners
from tap_service.status import reports_of

SLICE_S: Final = 0.05
"""Work at a stretch."""

REST_RATIO: Final = 3.0
"""Rest over work while the loop runs: a quarter of a core at most."""

BELIEF_PERIOD_S: Final = 0.5
"""Between two looks at what the eavesdroppers believe."""

START_S: Final = 20.0
"""Seconds that a user's eavesdropper has to be loaded and made."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """What such a process is told at its start.

    Parameters
    ----------
    run_dir : Path
    guesses : Path
        The log of its guesses, below ``run_dir``.
    told : dict
        What each of its eavesdroppers is told.
    limits : Bounds
        Of the log.
    header : dict
        Of the capture, and of the log.
    answer_s : float
        Seconds for each answer of a user's eavesdropper, whose memory is bounded too; 0: any time.
    """

    run_dir: Path
    guesses: Path
    told: dict[str, Knowledge]
    limits: Bounds
    header: dict[str, Any]
    answer_s: float = 0.0


def main() -> None:
    """The process: read, decode, report, rest; until the other end says so or is gone."""
    ignore_signals()
    line = line_of_child()
    os.nice(10)  # the loop and the mirror come first
    with suppress(EOFError, ConnectionError):  # the other end is gone: so is this one
        analyse(line.recv(), line)


def analyse(assignment: Assignment, line: Connection) -> None:
    """Wait for a capture of these settings (on a full disk there is none yet), and read it."""
    log = logger("tap.analysis")
    path = assignment.run_dir / assignment.guesses
    guesses = RotatingLog(path, assignment.header, assignment.limits, log)
    if assignment.answer_s:
        limit_memory()
        kill_after(START_S)
    listeners = Listeners(assignment.told, guesses.write, log, answer_s=assignment.answer_s)
    if assignment.answer_s:
        kill_after(0.0)
    reader = _reader_of(assignment, line)
    if reader is not None:
        _read(reader, listeners, guesses, line)
    guesses.close()
    line.send_bytes(b"null")


def _reader_of(assignment: Assignment, line: Connection) -> CaptureReader | None:
    """The capture, once it is there; None where the end comes first."""
    complaints = RateLimitedLog(logger("tap.analysis"))
    try:
        while True:
            try:
                return CaptureReader(assignment.run_dir / CAPTURE, assignment.header)
            except CaptureError as error:
                complaints.add(str(error))
            if line.poll(BELIEF_PERIOD_S):  # told to finish, or nobody is there any more
                return None
    finally:
        complaints.report_held_back(last=True)


def _read(
    reader: CaptureReader, listeners: Listeners, guesses: RotatingLog, line: Connection
) -> None:
    finishing = last = False
    next_belief = 0.0
    while not last:
        start = time.monotonic()
        empty = _work(reader, listeners, start + SLICE_S)
        guesses.flush()
        last = empty and finishing
        if last:
            listeners.finish()
        now = time.monotonic()
        if now >= next_belief or last:
            for status, record in reports_of(listeners, behind=reader.behind_steps, last=last):
                told = {"status": status.wire().decode(), "record": record}
                line.send_bytes(to_json(told, inf_nan_mode="strings"))
            spent = time.monotonic() - now
            # a costly look is repeated the more rarely
            next_belief = time.monotonic() + max(BELIEF_PERIOD_S, spent * REST_RATIO)
        worked = time.monotonic() - start
        pause = 0.0 if finishing else max(worked * REST_RATIO, 0.02 if empty else 0.0)
        if not last and line.poll(pause):
            finishing = line.recv() == "finish"


def _work(reader: CaptureReader, listeners: Listeners, until: float) -> bool:
    """Read until then, or all that is there; whether it is all."""
    for _t_ns, message in reader.records():
        listeners.hear(message)
        if time.monotonic() >= until:
            return False
    return True


if __name__ == "__main__":
    main()
