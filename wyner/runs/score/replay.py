"""A recorded capture, decoded again: the same transcript, the same eavesdroppers, no network."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from protocol.knowledge import Knowledge
from protocol.messages.adversary import UnusedStatus
from protocol.scenario import Scenario
from tap_service.capture.channel import View
from tap_service.capture.reading import CaptureError, CaptureReader
from tap_service.capture.transcript import Transcript
from tap_service.eavesdroppers import ORACLE, KnowledgeError, named
from tap_service.listening import Listeners
from tap_service.status import report_of
from wyner.printout import Printout
from wyner.runs.score.plain import plain
from wyner.runs.score.score import Guesses, TapOutput
from wyner.runs.score.summary import in_short
from wyner.runs.score.words import held_line, unused_in_words


def hear_again(path: Path, names: Sequence[str], scenario: Scenario | None = None) -> "Decoded":
    """Feed a capture to eavesdroppers.

    Parameters
    ----------
    path : Path
        A capture, or the directory of a run.
    names : sequence of str
        Eavesdroppers, by name or as ``FILE.py:NAME``.
    scenario : Scenario, optional
        The run's: the oracle is told what its defender knows. All others are told what the
        capture's header says that they were told live.

    Raises
    ------
    CaptureError
        When the capture cannot be read or its header lacks what they were told.
    KnowledgeError
        When an eavesdropper cannot be made.
    """
    reader = CaptureReader(path)
    try:
        knowledge = Knowledge.model_validate(reader.header["knowledge"])
        view = View.model_validate(reader.header["view"])
    except (KeyError, ValueError):
        raise CaptureError(
            f"{reader.path}: line 1: expected knowledge and view in the header"
        ) from None
    told = {}
    for name in names:
        if name != ORACLE:
            told[name] = view.knowledge(knowledge, model=named(name).told_model)
        elif scenario is None:
            raise KnowledgeError(f"{ORACLE}: expected a run's folder, for its alpha")
        else:
            told[name] = scenario.oracle_knowledge()
    guesses = Guesses(lossless=view.hears_all)
    listeners = Listeners(told, lambda line: guesses.take(from_json(line)))
    for _t_ns, message in reader.records():
        listeners.hear(message)
    reader.finish()
    listeners.finish()
    transcript = listeners.transcript
    unused = UnusedStatus(
        **transcript.unused._asdict(), dropped=reader.torn, malformed=reader.malformed
    )
    reports = [report_of(listeners.session, x, unused, last=True) for x in listeners.listeners]
    transitions = max((status.steps for status, _ in reports), default=0)
    taps = tuple(guesses.said(record) for _, record in reports)
    figures = _figures(reader, transcript, transitions, taps)
    lines = _lines(transcript, transitions, taps)
    return Decoded(figures, lines, reader, transcript, transitions, taps)


@dataclass(frozen=True, eq=False)
class Decoded(Printout):
    """What eavesdroppers made of a capture alone, of which the truth is not known.

    Parameters
    ----------
    reader : CaptureReader
        Which says what of the capture could not be read.
    transcript : Transcript
        What the messages were put together to.
    transitions : int
    taps : tuple of TapOutput
    """

    reader: CaptureReader
    transcript: Transcript
    transitions: int
    taps: tuple[TapOutput, ...]

    @property
    def failed(self) -> bool:
        """Whether an eavesdropper failed."""
        return any(tap.failed for tap in self.taps)

    @property
    def notes(self) -> list[str]:
        """What of the capture could not be read."""
        found = []
        if self.reader.torn:
            found.append(f"{self.reader.torn} torn lines were left out")
        if self.reader.parts_missing:
            found.append(f"{self.reader.parts_missing} parts of the capture are missing")
        return found


def _figures(
    reader: CaptureReader, transcript: Transcript, transitions: int, taps: Sequence[TapOutput]
) -> dict[str, Any]:
    """Per eavesdropper its message and how sure it is."""
    by_name = {}
    for tap in taps:
        b = tap.belief
        by_name[tap.name] = {
            "message": b.message.decode("utf-8", errors="replace"),
            "whole": [base64.b64encode(w).decode("ascii") for w in b.whole],
            "confidence": b.confidence,
            "candidates_left": b.candidates_left,
            "solved_k": b.solved_k,
            "failed": tap.failed,
            "keys": plain(b.keys),
        }
    return {
        "capture": str(reader.path),
        "transitions": transitions,
        "sessions": transcript.sessions,
        "holes": transcript.holes,
        **transcript.unused._asdict(),
        "torn_lines": reader.torn,
        "malformed": reader.malformed,
        "parts_missing": reader.parts_missing,
        "taps": by_name,
    }


def _lines(transcript: Transcript, transitions: int, taps: Sequence[TapOutput]) -> list[str]:
    """Two or three lines for each eavesdropper."""
    lines = [f"{transitions} transitions, {transcript.holes} with something missing"]
    if told := unused_in_words(transcript.unused._asdict()):
        lines.append(f"not used of what the tap heard: {told}")
    for tap in taps:
        if tap.failed:
            lines.append(f"{tap.name}: it failed: {tap.failed}")
            continue
        b = tap.belief
        solved = f"first whole message at k {b.solved_k}" if b.solved_k >= 0 else "none whole"
        lines.append(f"{tap.name}: {solved}, {b.candidates_left} candidates left")
        message = b.message.decode("utf-8", errors="replace")
        lines.append(f"  best message: {in_short(message)}")
        if b.keys is not None:
            lines.append(f"  {held_line(b.keys)}")
    return lines
