"""The field bus as the tap's capture holds it, read once from its first part to its last."""

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import to_json

from protocol.knowledge import Knowledge
from runtime.recording import CONTINUED, END, HEADER, number_of, parts_of
from tap_service.capture.channel import View
from wyner.runs.lines import STRICT, wrong
from wyner.runs.marks import Problem, Segments

SHOWN: Final = 60
"""Bytes of a malformed message that are shown."""


class CaptureHeader(BaseModel):
    """The first line of each part of a capture: what the tap says of itself."""

    model_config = STRICT

    event: Literal["header"]
    part: int
    oldest: Literal[0] = 0
    format: Literal["wyner-trace"]
    version: Literal[2]
    vantage: Literal["tap"]
    capture_version: Literal[2]
    started_ns: int = 0
    loop: str
    knowledge: Knowledge
    view: View
    eavesdroppers: list[str]
    appearances: int
    wyner_version: str


class CapturedMessage(NamedTuple):
    """A line of the capture that holds a message; ``raw`` is the message as it travels."""

    where: str
    raw: bytes
    topic: str
    session: str
    k: int
    message: dict[str, Any]


class CaptureLines:
    """A capture as a stream of messages.

    Attributes
    ----------
    blurred : bool
        The tap was told to see numbers badly, so that they cannot be compared; its header says so.
    strange : list of Problem
        Lines that hold no message of the field bus.
    parts : list of Segments
        Each part's marks.
    lines : dict of int
        Well-formed and malformed messages together, by the number of the part.
    dropped_parts : int
        Parts that were dropped for want of room, from the beginning.
    """

    def __init__(self, path: Path) -> None:
        self.blurred = False
        self.strange: list[Problem] = []
        self.parts: list[Segments] = []
        self.lines: dict[int, int] = {}
        self._paths = parts_of(path)
        self.dropped_parts = number_of(self._paths[0]) if self._paths else 0

    def __bool__(self) -> bool:
        return bool(self._paths)

    def __iter__(self) -> Iterator[CapturedMessage]:
        expected = self.dropped_parts
        for part in self._paths:
            marks = Segments(part.name)
            self.parts.append(marks)
            self.lines[number_of(part)] = 0
            if number_of(part) != expected:
                marks.problem(1, f"part {expected} is missing before it")
            expected = number_of(part) + 1
            for number, _, value in marks.read(part):
                assert value is not None
                kind = value.get("event")
                if kind == HEADER:
                    self._headed(part, marks, number, value)
                elif kind not in (CONTINUED, END):
                    seen = self._message(part, number, value)
                    if seen is not None:
                        yield seen

    def _headed(self, part: Path, marks: Segments, number: int, header: dict[str, Any]) -> None:
        if header.get("part") != number_of(part):
            marks.problem(number, f"part: got {header.get('part')!r}")
        try:
            view = CaptureHeader.model_validate_json(to_json(header)).view
        except ValidationError as error:
            marks.problem(number, wrong(error))
        else:
            self.blurred = bool(view.noise or view.quantise)

    def _message(self, part: Path, number: int, value: dict[str, Any]) -> CapturedMessage | None:
        kind, message = value.get("event"), value.get("message")
        where = f"{part.name} line {number}"
        field = kind == "field" and value.keys() == {"event", "t_ns", "topic", "message"}
        self.lines[number_of(part)] += field or kind == "malformed"
        if not field or not isinstance(message, dict):
            text = "no message" if field else f"event {kind!r}"
            text = _malformed(value) if kind == "malformed" else text
            self.strange.append(Problem(where, text))
            return None
        k, session = message.get("k"), message.get("session")
        return CapturedMessage(
            where,
            to_json(message),
            str(value.get("topic")),
            session if isinstance(session, str) else "",
            k if isinstance(k, int) else -1,
            message,
        )


def _malformed(line: dict[str, Any]) -> str:
    """What a capture's line of a malformed message holds: its key, and how its bytes begin."""
    try:
        content = base64.b64decode(str(line.get("base64")))
    except ValueError:
        content = b""
    return f"{line.get('key')}: {content[:SHOWN]!r}"
