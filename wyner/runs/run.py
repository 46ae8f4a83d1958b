"""A run's folder, opened once: every command that looks at a run reads it through this.

What a kill leaves is resolved here (:mod:`wyner.runs.resolve`): torn lines, steps and reports that
were written twice, steps made again from an older journal. Files are read as streams, so that a
run of a million steps is never in memory as a whole.
"""

import base64
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic_core import from_json

from protocol.link.records import Side
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from runtime.files import read_regular
from runtime.recording import TraceError, TraceReader, ended, parts_of, read_lines
from runtime.run_folder import (
    ANALYSIS_GUESSES,
    BELIEFS,
    CAPTURE,
    CONTROLLER_TRACE,
    GUESSES,
    MANIFEST,
    PLANT_TRACE,
    SCENARIO,
    TAP_STATUS,
)
from runtime.scenario_file import load_scenario
from tap_service.capture.reading import CaptureReader
from wyner.runs.resolve import Event, Resolved

if TYPE_CHECKING:
    from wyner.runs.trace import Trace

TRACES: Final[dict[Side, Path]] = {"plant": PLANT_TRACE, "controller": CONTROLLER_TRACE}


class RunError(Exception):
    """Something of a run that cannot be read; one line."""


@dataclass(frozen=True)
class Run:
    """A run, from its folder. Nothing is read before it is asked for.

    Parameters
    ----------
    folder : Path
    """

    folder: Path

    @classmethod
    def load(cls, folder: str | Path) -> "Run":
        """Open a run's folder, also one that a kill or a lone service left incomplete.

        Raises
        ------
        RunError
            When there is no such folder.
        """
        path = Path(folder)
        if not path.is_dir():
            raise RunError(f"{path}: no run here, expected a run's folder")
        return cls(path)

    @property
    def name(self) -> str:
        """What it is called in a report."""
        return self.folder.name

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario that it was made under.

        Raises
        ------
        protocol.scenario.ScenarioError
            When it cannot be read.
        """
        return load_scenario(self.folder / SCENARIO)

    @cached_property
    def manifest(self) -> dict[str, Any] | None:
        """None where there is none; empty where it is no JSON object."""
        path = self.folder / MANIFEST
        if not path.is_file():
            return None
        try:
            value = json.loads(read_regular(path))
        except (ValueError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    def trace(self, side: Side) -> Path:
        """The first part of an end's trace, also where it is there no more."""
        return self.folder / TRACES[side]

    def read(self, side: Side, pending: dict[str, Any] | None = None) -> "Trace":
        """An end's trace in columns; ``pending`` is what its journal holds beyond it.

        Raises
        ------
        OSError
            When it cannot be read.
        """

        from wyner.runs.trace import Trace

        noisy = self.scenario.plant.noise is not None
        return Trace(side, self.trace(side), rules_of(self.scenario), noisy=noisy, pending=pending)

    def has(self, side: Side) -> bool:
        """Whether any part of an end's trace is there."""
        return bool(parts_of(self.trace(side)))

    def parts_missing(self, side: Side) -> int:
        """The oldest parts of an end's trace that are gone.

        Raises
        ------
        runtime.recording.TraceError
            When it cannot be read.
        """
        return TraceReader(self.trace(side)).parts_missing

    def ended(self, side: Side) -> bool:
        """Whether an end's trace was ended by itself: it was not killed, and nothing is cut off.

        Raises
        ------
        runtime.recording.TraceError
            When it cannot be read.
        """
        try:
            return ended(self.trace(side))
        except OSError as error:
            raise TraceError(f"{error.filename}: cannot be read: {error.strerror}") from None

    def feed(self, side: Side, *takers: Callable[[Event], object]) -> int:
        """Hand every event of an end's trace that counts to each taker, in order.

        Returns
        -------
        int
            Steps that an end made again after its journal was put back, and that did not count.

        Raises
        ------
        runtime.recording.TraceError
            When the trace cannot be read, or from a line on that no such end wrote.
        """
        reader = TraceReader(self.trace(side))
        events = Resolved(reader.lines())
        try:
            for event in events:
                for take in takers:
                    take(event)
        except (LookupError, TypeError, ValueError) as error:
            what = f"{type(error).__name__}: {error}"
            raise TraceError(f"{TRACES[side]}: a line is not as expected: {what}") from None
        return events.behind

    def sent(self) -> list[bytes]:
        """The messages that the controller was handed, in order; none where it left no trace.

        Raises
        ------
        runtime.recording.TraceError
            When its trace cannot be read.
        """
        sent: dict[str, bytes] = {}
        if not self.has("controller"):
            return []

        def take(event: Event) -> None:
            if event["event"] == "sent":
                sent.setdefault(event["id"], base64.b64decode(event["payload"]))

        self.feed("controller", take)
        return list(sent.values())

    def capture(self) -> CaptureReader:
        """What the tap heard.

        Raises
        ------
        tap_service.capture.reading.CaptureError
            When there is none, or it cannot be read.
        """
        return CaptureReader(self.folder / CAPTURE)

    def beliefs(self) -> dict[str, dict[str, Any]]:
        """The last belief of each eavesdropper.

        Raises
        ------
        RunError
            When the tap left none that can be read.
        """
        path = self.folder / BELIEFS
        try:
            found = from_json(read_regular(path))
        except OSError as error:
            raise RunError(f"{path}: cannot be read: {error.strerror}") from None
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise RunError(f"{path}: expected the tap's beliefs as JSON")
        return found

    def guesses(self) -> Iterator[Event]:
        """Every guess and second thought of the eavesdroppers, as the tap wrote them."""
        for stem in (GUESSES, ANALYSIS_GUESSES):
            for path in parts_of(self.folder / stem):
                for line in read_lines(path):
                    event = line.value or {}
                    if event.get("event") in ("guess", "review"):
                        yield event

    def unguessed(self) -> int:
        """Messages that the tap left out of its live guessing, since too many waited."""
        try:
            return int(json.loads(read_regular(self.folder / TAP_STATUS))["unguessed"])
        except (OSError, ValueError, LookupError, TypeError):
            return 0
