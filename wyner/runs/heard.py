"""The field bus as the tap's capture holds it, read once from its first part to its last."""

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from pydantic import ValidationError
from pydantic_core import to_json

from runtime.recording import CONTINUED, END, HEADER, number_of, parts_of
from tap_service.capture.channel import View
from tap_service.capture.recording import CAPTURE_VERSION
from wyner.runs.marks import HEADS, Problem, Segments

SHOWN: Final = 60
"""Bytes of a malformed message that are shown."""

CAPTURE_HEADS: Final = {**HEADS, "vantage": "tap", "capture_version": CAPTURE_VERSION}

TOLD: Final = frozenset(
    ("event", "part", "oldest", "started_ns", "loop", "knowledge", "view", "eavesdroppers")
) | {"appearances", "wyner_version"}
"""What else a capture's header may hold."""


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
        expected = {**CAPTURE_HEADS, "part": number_of(part)}
        for name in [name for name, due in expected.items() if header.get(name) != due]:
            marks.problem(number, f"{name}: got {header.get(name)!r}")
        if unlike := _unlike_header(header):
            marks.problem(number, unlike)
        else:
            self.blurred = bool(header["view"].get("noise") or header["view"].get("quantise"))

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


def _unlike_header(header: dict[str, Any]) -> str:
    """What no tap says of itself; empty where all may be."""
    strange = sorted(header.keys() - CAPTURE_HEADS.keys() - TOLD)
    if strange or header.get("oldest", 0) != 0:
        return f"{(*strange, 'oldest')[0]}: not in a capture's header"
    try:
        View.model_validate(header.get("view"), strict=True)
    except ValidationError as error:
        return f"view: {error.error_count()} fields are not as expected"
    return ""


def _malformed(line: dict[str, Any]) -> str:
    """What a capture's line of a malformed message holds: its key, and how its bytes begin."""
    try:
        content = base64.b64decode(str(line.get("base64")))
    except ValueError:
        content = b""
    return f"{line.get('key')}: {content[:SHOWN]!r}"
