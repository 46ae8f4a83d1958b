"""The heavy eavesdroppers' own process: reads the capture behind the mirror, at its own pace.

The capture on disk is the queue between the two, so nothing is lost when this process is slow and
the mirror never waits for it. It rests in proportion to its work, so that it takes a bounded share
of a core; where it falls further behind than the capture keeps, the reader counts what is missing.
"""

import logging
import os
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage
from runtime.child import ignore_signals, line_of_child
from runtime.recording import Bounds
from runtime.run_folder import ANALYSIS_GUESSES, CAPTURE
from tap_service.capture.reading import CaptureError, CaptureReader
from tap_service.capture.recording import RotatingLog
from tap_service.capture.transcript import Transcript, Transition
from tap_service.eavesdroppers import Guess
from tap_service.sandboxed import sandboxed
from tap_service.status import Listener, belief_record, guess_line, status_of

SLICE_S: Final = 0.05
"""Work at a stretch."""

REST_RATIO: Final = 3.0
"""Rest over work while the loop runs: a quarter of a core at most."""

FAR_BEHIND: Final = 128 * 2**20
"""Bytes of capture not read yet beyond which they are skipped and counted: a third of a million
steps, about a minute of lock-step at full speed."""

BELIEF_PERIOD_S: Final = 0.5
"""Between two looks at what the heavy eavesdroppers believe."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """What the analysis process is told; handed over at its start."""

    run_dir: Path
    names: tuple[str, ...]
    knowledge: dict[str, Knowledge]
    limits: Bounds
    header: dict[str, Any]


class Listeners:
    """Several eavesdroppers on one transcript.

    Parameters
    ----------
    listeners : sequence of Listener
    log : RotatingLog, optional
        Where their guesses go.
    """

    def __init__(self, listeners: Sequence[Listener], log: RotatingLog | None) -> None:
        self.listeners = tuple(listeners)
        self.session = ""
        self._log = log

    def hear(self, message: FieldMessage, transitions: Iterable[Transition]) -> None:
        """Hand a message to those that hear them, then each transition that it settles to all."""
        for listener in self.listeners:
            listener.hear(message)
        self.feed(transitions)

    def feed(self, transitions: Iterable[Transition]) -> None:
        """Let each observe each transition."""
        for transition in transitions:
            self.session = transition.session
            for listener in self.listeners:
                guess = listener.observe(transition)
                if guess is not None and self._log is not None:
                    session, whole = transition.session, transition.whole
                    self._log.write(guess_line(session, listener.name, guess, whole=whole))
                self._note(listener, listener.final_guesses())

    def review(self, listener: Listener) -> None:
        """Log one's second thoughts."""
        self._note(listener, listener.review())

    def _note(self, listener: Listener, thoughts: Sequence[Guess]) -> None:
        for guess in thoughts:
            if self._log is not None:
                self._log.write(guess_line(self.session, listener.name, guess, "review"))


def listeners_of(
    names: Iterable[str], knowledge: dict[str, Knowledge], log: logging.Logger | None = None
) -> list[Listener]:
    """Eavesdroppers by name, each with what she is told; ``log`` is told when one fails.

    Raises
    ------
    KnowledgeError
        When one cannot be found or is not told enough.
    """
    return [Listener.of(sandboxed(name), knowledge[name], log) for name in names]


def main() -> None:
    """The process: read, decode, report, rest; until the other end says so or is gone."""
    ignore_signals()
    line = line_of_child()
    os.nice(10)  # the loop and the mirror come first
    with suppress(EOFError, ConnectionError):  # the other end is gone: so is this one
        analyse(line.recv(), line)


def analyse(assignment: Assignment, line: Connection) -> None:
    """Wait for a capture of these settings (on a full disk there is none yet), and read it."""
    from runtime.logs import RateLimitedLog, logger

    complaints = RateLimitedLog(logger("tap.analysis"))
    log = RotatingLog(
        assignment.run_dir / ANALYSIS_GUESSES,
        assignment.header,
        assignment.limits,
        logger("tap.analysis"),
    )
    told = logger("tap.analysis")
    listeners = Listeners(listeners_of(assignment.names, assignment.knowledge, told), log)
    while True:
        try:
            reader = CaptureReader(assignment.run_dir / CAPTURE, assignment.header)
            break
        except CaptureError as error:
            complaints.add(str(error))
        if line.poll(BELIEF_PERIOD_S):  # told to finish, or nobody is there any more
            complaints.report_held_back(last=True)
            log.close()
            line.send(None)
            return
    complaints.report_held_back(last=True)
    transcript = Transcript()
    finishing = False
    next_belief = 0.0
    while True:
        start = time.monotonic()
        until = start + SLICE_S
        empty = False
        for _t_ns, message in reader.records():
            listeners.hear(message, transcript.hear(message))
            if time.monotonic() >= until:
                break
        else:
            empty = True
        log.flush()
        if not finishing and reader.behind_bytes > FAR_BEHIND:
            reader.skip(FAR_BEHIND // 2)
        if empty and finishing:
            listeners.feed(transcript.flush())
        now = time.monotonic()
        if now >= next_belief or (empty and finishing):
            _report(listeners, reader, transcript, line, last=empty and finishing)
            spent = time.monotonic() - now
            # a costly look is repeated the more rarely
            next_belief = time.monotonic() + max(BELIEF_PERIOD_S, spent * REST_RATIO)
        if empty and finishing:
            log.close()
            line.send(None)
            return
        worked = time.monotonic() - start
        pause = 0.0 if finishing else max(worked * REST_RATIO, 0.02 if empty else 0.0)
        if line.poll(pause):
            finishing = line.recv() == "finish"


def _report(
    listeners: Listeners,
    reader: CaptureReader,
    transcript: Transcript,
    line: Connection,
    *,
    last: bool,
) -> None:
    behind = reader.behind_steps
    for listener in listeners.listeners:
        if last:
            listeners.review(listener)
        belief = listener.belief()
        counts = dict.fromkeys(("seq", "t_ns", "mirrored", "malformed"), 0) | {
            "behind": behind,
            "dropped": reader.skipped,
            **transcript.unused._asdict(),
        }
        session = listeners.session
        record = belief_record(session, listener, belief, last=last, behind=behind, counts=counts)
        line.send((status_of(listener, belief, counts), record))


if __name__ == "__main__":
    main()
