"""What a run left behind, read for checking: both traces and the capture, each in its own terms.

Nothing here judges. A side that was killed may have written one (session, j) twice (the last
counts), and may have left a torn last line; both are kept apart from what is malformed.
"""

import base64
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic_core import from_json

from protocol.link.session import Rules, rules_of
from protocol.runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE, SCENARIO
from protocol.runtime.trace import Trace, TraceReader
from protocol.scenario import Scenario, load_scenario
from tap_service.capture.recording import parts_of

Vector = tuple[float, ...]

SHOWN: Final = 60
"""Bytes of garbage that are shown."""


@checked_dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class Counted:
    """A transition as one side's trace holds it; ``coin`` and ``u`` are the plant's alone.

    A model would take three times the room, and a run has millions.
    """

    event: Literal["transition"]
    session: str
    j: int
    k: int
    x: Vector
    candidates: tuple[Vector, ...]
    cipher: int
    x_next: Vector
    role: Literal["test", "message"]
    gauges: Vector
    symbol: int
    key: int
    message_symbol: int
    p: int
    s: int
    coin: int | None = None
    u: Vector | None = None


@checked_dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class Missed:
    """A step without an offer, as the plant's trace holds it."""

    event: Literal["missed"]
    session: str
    k: int
    x: Vector
    u: Vector
    x_next: Vector


_COUNTED: Final = TypeAdapter(Counted)
_MISSED: Final = TypeAdapter(Missed)


class Problem(NamedTuple):
    """A line that cannot be what it says it is."""

    where: str
    text: str


@dataclass(frozen=True, slots=True)
class Side:
    """One end's trace.

    Parameters
    ----------
    trace : Trace
        Without the steps, which are below.
    sessions : dict of list of Counted
        Transitions by session in the order of j; of several with one j the last written.
    overwritten : tuple of (Counted, Counted)
        Each transition that was written again, and the one that counts.
    lives : tuple of dict
        The plant's steps by k, a new one wherever the plant began again at k = 0.
    problems : tuple of Problem
    """

    trace: Trace
    sessions: dict[str, list[Counted]]
    overwritten: tuple[tuple[Counted, Counted], ...]
    lives: tuple[dict[int, Counted | Missed], ...]
    problems: tuple[Problem, ...]

    @property
    def transitions(self) -> Iterator[Counted]:
        """All that count, session by session."""
        return (t for ts in self.sessions.values() for t in ts)


class Seen(NamedTuple):
    """A line of the capture that holds a message.

    The message is read from the line each time it is asked for: a run has millions, and as objects
    they take ten times the room.
    """

    part: str
    number: int
    line: bytes
    topic: str
    session: str
    k: int

    @property
    def where(self) -> str:
        """The line's place."""
        return f"{self.part} line {self.number}"

    @property
    def raw(self) -> bytes:
        """The message as it travelled."""
        return self.line.partition(b'"message":')[2][:-1]

    @property
    def message(self) -> dict[str, Any]:
        """The message as JSON."""
        message: dict[str, Any] = from_json(self.line)["message"]
        return message


@dataclass(frozen=True, slots=True)
class Wire:
    """The field bus as the tap's capture holds it.

    ``blurred`` says that the tap was told to see numbers badly, so that they cannot be compared;
    ``strange`` are the lines that hold no Measurement or Offer, ``torn`` counts lines cut short.
    """

    seen: tuple[Seen, ...]
    strange: tuple[Problem, ...]
    torn: int
    blurred: bool


@dataclass(frozen=True, slots=True)
class Evidence:
    """Everything that a check looks at; what a run did not leave is None."""

    run_dir: Path
    scenario: Scenario
    rules: Rules
    plant: Side | None
    controller: Side | None
    wire: Wire | None


@dataclass(slots=True)
class _Reading:
    """A side under way."""

    last: dict[tuple[str, int], Counted] = field(default_factory=dict)
    again: list[Counted] = field(default_factory=list)
    lives: list[dict[int, Counted | Missed]] = field(default_factory=list)
    born_in: str = ""
    problems: list[Problem] = field(default_factory=list)

    def step(self, step: Counted | Missed) -> None:
        """File a step under the plant's life it belongs to."""
        if not self.lives or (step.k == 0 and step.session != self.born_in):
            self.lives.append({})
            self.born_in = step.session
        self.lives[-1][step.k] = step

    def transition(self, t: Counted) -> None:
        """File a transition; one of the same number that is there already was overwritten."""
        at = (t.session, t.j)
        if at in self.last:
            self.again.append(self.last[at])
        self.last[at] = t


def side_of(trace: TraceReader) -> Side:
    """Sort one end's events."""
    reading = _Reading()
    told = []
    for number, event in enumerate(trace, start=1):
        kind = event["event"]
        try:
            if kind == "transition":
                t = _COUNTED.validate_python(event)
                reading.transition(t)
                reading.step(t)
            elif kind == "missed":
                reading.step(_MISSED.validate_python(event))
            else:
                told.append(event)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            path = ".".join(str(part) for part in first["loc"])
            text = f"{kind}: {path}: {first['msg'].lower()}"
            reading.problems.append(Problem(where=f"event {number}", text=text))
    sessions: dict[str, list[Counted]] = {}
    for t in reading.last.values():
        sessions.setdefault(t.session, []).append(t)
    for ts in sessions.values():
        ts.sort(key=lambda t: t.j)
    return Side(
        trace=Trace(trace.header, tuple(told), trace.torn),
        sessions=sessions,
        overwritten=tuple((t, reading.last[t.session, t.j]) for t in reading.again),
        lives=tuple(reading.lives),
        problems=tuple(reading.problems),
    )


def wire_of(path: Path) -> Wire | None:
    """Read a capture, part by part; None where there is none.

    The messages are taken as they stand on the line: a reader that refuses unknown fields could
    not see one.
    """
    seen: list[Seen] = []
    strange: list[Problem] = []
    torn = 0
    blurred = False
    parts = parts_of(path)
    for part in parts:
        with part.open("rb") as file:
            for number, ended in enumerate(file, start=1):
                line = ended.removesuffix(b"\n")
                if not line:
                    continue
                where = f"{part.name} line {number}"
                try:
                    value = from_json(line)
                except ValueError:
                    torn += 1
                    continue
                event = value.get("event") if isinstance(value, dict) else None
                if event in ("end", "continued"):
                    continue
                if event == "header":
                    view = value.get("view", {})
                    blurred = blurred or bool(view.get("noise") or view.get("quantise"))
                elif event == "field" and isinstance(value.get("message"), dict):
                    message = value["message"]
                    k = message.get("k")
                    seen.append(
                        Seen(
                            part=part.name,
                            number=number,
                            line=line,
                            topic=sys.intern(str(value.get("topic"))),
                            session=sys.intern(str(message.get("session", ""))),
                            k=k if isinstance(k, int) else -1,
                        )
                    )
                else:
                    text = _garbage(value) if event == "garbage" else str(event)
                    strange.append(Problem(where=where, text=text))
    return Wire(tuple(seen), tuple(strange), torn, blurred) if parts else None


def _garbage(line: dict[str, Any]) -> str:
    """What a capture's line of garbage holds: its key, and how its bytes begin."""
    try:
        content = base64.b64decode(str(line.get("base64")))
    except ValueError:
        content = b""
    return f"{line.get('key')}: {content[:SHOWN]!r}"


def read_evidence(run_dir: Path) -> Evidence:
    """Read a run's folder.

    Raises
    ------
    FileNotFoundError
        When there is no run: no scenario, or neither end's trace.
    protocol.scenario.ScenarioError, protocol.runtime.trace.TraceError
        When one of them cannot be read.
    """
    if not (run_dir / SCENARIO).is_file():
        raise FileNotFoundError(f"{run_dir}: no run here, expected {SCENARIO}")
    scenario = load_scenario(run_dir / SCENARIO)
    # the controller's first: should the run go on, the plant is then ahead and not behind
    sides = {
        path: side_of(TraceReader(run_dir / path)) if (run_dir / path).is_file() else None
        for path in (CONTROLLER_TRACE, PLANT_TRACE)
    }
    if not any(sides.values()):
        raise FileNotFoundError(
            f"{run_dir}: no run here, expected {PLANT_TRACE} or {CONTROLLER_TRACE}"
        )
    return Evidence(
        run_dir=run_dir,
        scenario=scenario,
        rules=rules_of(scenario),
        plant=sides[PLANT_TRACE],
        controller=sides[CONTROLLER_TRACE],
        wire=wire_of(run_dir / CAPTURE),
    )
