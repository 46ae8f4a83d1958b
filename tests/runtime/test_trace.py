"""Traces: a line an event, what was flushed is there, a torn line costs itself only."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest

from runtime.recording import (
    Bounds,
    TraceWriter,
    parts_of,
    read_lines,
)
from tests.support.lines import unmark
from tests.support.traces import events_of


def values(path: Path) -> list[dict[str, Any] | None]:
    """What each line holds; None where it is torn."""
    return [line.value for line in read_lines(path)]


def write(path: Path, *events: dict[str, object]) -> None:
    writer = TraceWriter(path, "plant", {"scenario": "paper"})
    for event in events:
        writer.write(event)
    writer.close()


def test_lines_that_belong_together_are_one_write_to_one_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No death comes between a transition and its report, and no end of a part."""
    written: list[bytes] = []
    to_disk = os.write

    def watched(file: int, data: bytes) -> int:
        written.append(data)
        return to_disk(file, data)

    monkeypatch.setattr(os, "write", watched)
    path, bounds = tmp_path / "trace.jsonl", Bounds(part_bytes=1024, total_bytes=1 << 20)
    writer = TraceWriter(path, "plant", {}, bounds)
    for i in range(60):
        writer.write({"event": "first", "i": i, "more": "x" * (i % 7)}, {"event": "second", "i": i})
    writer.close()
    pairs = [data for data in written if b"first" in data or b"second" in data]
    assert [data.count(b"\n") for data in pairs] == [2] * 60
    parts = parts_of(path)
    assert len(parts) > 3
    for part in parts:
        assert part.stat().st_size <= 1024
        header, *events, end = [json.loads(line) for line in part.read_bytes().splitlines()]
        assert [e["event"] for e in events] == ["first", "second"] * (len(events) // 2)
        assert end["lines"] == len([header, *events])
        body = part.read_bytes().rpartition(b'{"event":"end"')[0]
        assert end["sha256"] == hashlib.sha256(body).hexdigest()
    for name in ("first", "second"):
        assert [event["i"] for event in events_of(path, name)] == [*range(60)]


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_a_torn_last_line_loses_that_line_only(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "t"
    write(path, {"event": "a", "k": 1}, {"event": "b", "long": "x" * 30})
    unmark(path)
    path.write_bytes(path.read_bytes()[: -1 - cut])
    assert values(path)[1:] == [{"event": "a", "k": 1}, None]


def test_a_writer_that_comes_back_starts_on_a_fresh_line(tmp_path: Path) -> None:
    path = tmp_path / "t"
    write(path, {"event": "a"}, {"event": "torn", "k": 123456})
    unmark(path)
    path.write_bytes(path.read_bytes()[:-8])
    write(path, {"event": "b"})
    told = [value and value["event"] for value in values(path)]
    assert told == ["header", "a", None, "continued", "b", "end"]
