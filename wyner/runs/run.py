"""A run's folder, opened once: every command that looks at a run reads it through this.

Each end's trace is read once, into columns (:mod:`wyner.runs.trace`), which all that look at the
run share: some 100 bytes a step and end, of two states and two candidates.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from errno import ENOENT
from functools import cached_property
from os import strerror
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic_core import from_json

from protocol.link.records import Side
from protocol.link.session import rules_of
from protocol.scenario import Scenario, ScenarioError
from runtime.files import read_regular
from runtime.recording import TraceError, first_part, parts_of, read_lines
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

    @cached_property
    def _traces(self) -> "dict[Side, Trace]":
        return {}

    def read(self, side: Side) -> "Trace":
        """Read an end's trace, unless it was read before.

        Raises
        ------
        OSError
            When it cannot be read.
        """
        from wyner.runs.trace import Trace

        if side not in self._traces:
            noisy = self.scenario.plant.noise is not None
            rules = rules_of(self.scenario)
            self._traces[side] = Trace(side, self.trace(side), rules, noisy=noisy)
        return self._traces[side]

    def forget(self, side: Side) -> None:
        """Let go of an end's trace; it is read again if it is asked for."""
        self._traces.pop(side, None)

    def columns(self, side: Side) -> "Trace":
        """An end's trace in columns, read once whoever asks.

        Raises
        ------
        runtime.recording.TraceError
            When there is none, or it cannot be read.
        """
        try:
            if not self.has(side):
                raise FileNotFoundError(ENOENT, strerror(ENOENT), str(self.trace(side)))
            return self.read(side)
        except OSError as error:
            raise TraceError(f"{error.filename}: cannot be read: {error.strerror}") from None
        except ScenarioError as error:
            raise TraceError(str(error)) from None

    def whole(self, side: Side) -> "Trace":
        """An end's trace in columns, where it can be read to its end.

        Raises
        ------
        runtime.recording.TraceError
            When it cannot.
        """
        trace = self.columns(side)
        if trace.unread:
            raise TraceError(f"{self.trace(side)}: {trace.unread}")
        return trace

    def so_far(self, side: Side, problems: list[str]) -> "Trace | None":
        """An end's trace as far as it can be read; why it goes no further is added to these."""
        try:
            trace = self.columns(side)
        except TraceError as error:
            problems.append(str(error))
            return None
        if trace.unread:
            problems.append(f"{self.trace(side)}: {trace.unread}")
        return trace

    def has(self, side: Side) -> bool:
        """Whether any part of an end's trace is there."""
        return bool(parts_of(self.trace(side)))

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
        for told in self.whole("controller").told("sent"):
            sent.setdefault(getattr(told.line, "id", ""), told.payload)
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

    def guesses(self) -> Iterator[dict[str, Any]]:
        """Every guess and second thought of the eavesdroppers, as the tap wrote them."""
        for stem in guess_logs(self.folder):
            for path in parts_of(stem):
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


def guess_logs(folder: Path) -> list[Path]:
    """The tap's logs of guesses: the mirror's, and that of each process beside it."""
    beside = {first_part(p) for p in folder.glob(str(ANALYSIS_GUESSES.with_stem("analysis*")))}
    return [folder / GUESSES, *sorted(beside)]
