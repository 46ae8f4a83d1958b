"""A recorded capture, decoded again: the same transcript, the same eavesdroppers, no network."""

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.knowledge import Knowledge
from protocol.scenario import Scenario
from tap_service.capture.channel import View
from tap_service.capture.reading import CaptureError, CaptureReader
from tap_service.capture.transcript import Transcript
from tap_service.eavesdroppers import ORACLE, Guess, KnowledgeError, named
from tap_service.listening import Listener
from tap_service.status import unused_of
from wyner.runs.score.by_step import BySteps
from wyner.runs.score.report import held_line, unused_in_words
from wyner.runs.score.score import TapOutput
from wyner.runs.score.summary import in_short


class Replay:
    """Feeds a capture to eavesdroppers.

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

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        *,
        scenario: Scenario | None = None,
    ) -> None:
        self.reader = CaptureReader(path)
        header = self.reader.header
        try:
            self.knowledge = Knowledge.model_validate(header["knowledge"])
            self.view = View.model_validate(header["view"])
        except (KeyError, ValueError):
            raise CaptureError(
                f"{self.reader.path}: line 1: expected knowledge and view in the header"
            ) from None
        self.listeners: list[Listener] = []
        for name in names:
            kind = named(name)
            if name == ORACLE:
                if scenario is None:
                    raise KnowledgeError(f"{ORACLE}: expected a run's folder, for its alpha")
                mine = scenario.oracle_knowledge()
            else:
                mine = self.view.knowledge(self.knowledge, model=kind.told_model)
            self.listeners.append(Listener(kind, mine))
        self.transcript = Transcript()
        self.session = ""
        self.transitions = 0
        self.k = -1
        self._guesses: dict[str, BySteps] = {x.name: BySteps() for x in self.listeners}
        self._holes = BySteps()
        self._reviews: dict[str, BySteps] = {x.name: BySteps() for x in self.listeners}

    def run(self) -> None:
        """Decode all of it."""
        for _t_ns, message in self.reader.records():
            for listener in self.listeners:
                listener.hear(message)
            self._feed(self.transcript.hear(message))
        self.reader.finish()
        self._feed(self.transcript.flush())
        for listener in self.listeners:
            self._note(listener, listener.review())

    def _feed(self, final_guesses: Iterable[Any]) -> None:
        for t in final_guesses:
            self.session, self.k = t.session, t.k
            if self.view.hears_all and not t.whole:
                self._holes[t.session, t.k] = 1
            self.transitions += 1
            for listener in self.listeners:
                guess = listener.observe(t)
                if guess is not None:
                    self._guesses[listener.name][t.session, t.k] = guess.best
                self._note(listener, listener.final_guesses())

    def _note(self, listener: Listener, thoughts: Sequence[Guess]) -> None:
        reviews = self._reviews[listener.name]
        for guess in thoughts:
            reviews[guess.session or self.session, guess.k] = guess.best

    def outputs(self) -> list[TapOutput]:
        """What each said, for scoring."""
        out = []
        counts = {"malformed": self.reader.malformed, "dropped": self.reader.torn}
        unused = unused_of(counts | self.transcript.unused._asdict())
        for x in self.listeners:
            guesses = self._guesses[x.name], self._reviews[x.name]
            belief, symbols = x.belief(), x.message_symbols()
            out.append(
                TapOutput(
                    x.name,
                    self.session,
                    *guesses,
                    belief,
                    symbols or (),
                    x.failed,
                    holes=self._holes,
                    unused=unused,
                )
            )
        return out

    def decoded(self) -> "Decoded":
        """What each eavesdropper had at the end."""
        return Decoded(
            capture=str(self.reader.path),
            transitions=self.transitions,
            sessions=self.transcript.sessions,
            holes=self.transcript.holes,
            unused=self.transcript.unused._asdict(),
            torn=self.reader.torn,
            malformed=self.reader.malformed,
            parts_missing=self.reader.parts_missing,
            taps=tuple(self.outputs()),
        )


@dataclass(frozen=True)
class Decoded:
    """What eavesdroppers made of a capture alone, of which the truth is not known.

    Parameters
    ----------
    capture : str
    transitions, sessions : int
    holes : int
        Transitions of which the tap lacks something.
    unused : dict of str to int
        Messages that no transition was made of, by kind.
    torn, malformed, parts_missing : int
        Lines, messages and files that could not be read.
    taps : tuple of TapOutput
    """

    capture: str
    transitions: int
    sessions: int
    holes: int
    unused: dict[str, int]
    torn: int
    malformed: int
    parts_missing: int
    taps: tuple[TapOutput, ...]

    @property
    def failed(self) -> bool:
        """Whether an eavesdropper failed."""
        return any(tap.failed for tap in self.taps)

    @property
    def notes(self) -> list[str]:
        """What of the capture could not be read."""
        found = []
        if self.torn:
            found.append(f"{self.torn} torn lines were left out")
        if self.parts_missing:
            found.append(f"{self.parts_missing} parts of the capture are missing")
        return found

    def to_json(self) -> dict[str, Any]:
        """Per eavesdropper its message and how sure it is."""
        taps = {}
        for tap in self.taps:
            b = tap.belief
            taps[tap.name] = {
                "message": b.message.decode("utf-8", errors="replace"),
                "whole": [base64.b64encode(w).decode("ascii") for w in b.whole],
                "confidence": b.confidence,
                "candidates_left": b.candidates_left,
                "solved_k": b.solved_k,
                "failed": tap.failed,
                "keys": None if b.keys is None else b.keys.model_dump(),
            }
        return {
            "capture": self.capture,
            "transitions": self.transitions,
            "sessions": self.sessions,
            "holes": self.holes,
            **self.unused,
            "torn_lines": self.torn,
            "malformed": self.malformed,
            "parts_missing": self.parts_missing,
            "taps": taps,
        }

    def __str__(self) -> str:
        """Two or three lines for each eavesdropper."""
        lines = [f"{self.transitions} transitions, {self.holes} with something missing"]
        used_not = {name: self.unused[name] for name in ("foreign", "late", "jumped")}
        if told := unused_in_words(used_not):
            lines.append(f"not used of what the tap heard: {told}")
        for tap in self.taps:
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
        return "\n".join(lines)
