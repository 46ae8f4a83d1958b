"""Captures: nothing lost but a torn line, never more disk than allowed, and always said."""

import errno
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic_core import from_json

from protocol.messages import Measurement, Offer
from runtime import recording
from runtime.recording import Bounds, part_path, parts_of
from runtime.run_folder import CAPTURE
from tap_service.capture.reading import CaptureError, CaptureReader
from tap_service.capture.recording import RotatingLog, mirror_line
from tests.support.lines import unmark

LOG = logging.getLogger("test")
SESSION = "0123456789abcdef"
ROOMY = Bounds(free_bytes=0)


def measurement(k: int) -> Measurement:
    return Measurement(
        session=SESSION, k=k, x=(1 / 3, -0.1), applied_k=k - 1, x_after=(1 / 3, -0.1)
    )


def line_of(message: Measurement | Offer, t_ns: int = 0) -> bytes:
    return mirror_line(t_ns, message.topic, message.wire())


def record(path: Path, count: int, limits: Bounds = ROOMY) -> RotatingLog:
    log = RotatingLog(path, {"loop": "loop"}, limits, LOG)
    for k in range(count):
        log.write(line_of(measurement(k), k))
    return log


def read(path: Path) -> tuple[CaptureReader, list[Measurement | Offer]]:
    reader = CaptureReader(path)
    messages = list(of_the_loop(reader))
    reader.finish()
    return reader, messages


def of_the_loop(reader: CaptureReader) -> Iterator[Measurement | Offer]:
    for _, message in reader.records():
        yield message


def test_going_on_after_a_crash_begins_a_new_part(tmp_path: Path) -> None:
    path = tmp_path / CAPTURE
    record(path, 5).close()
    unmark(path)
    path.write_bytes(path.read_bytes()[:-10])
    record(path, 5).close()
    reader, messages = read(path)
    assert [m.k for m in messages] == [0, 1, 2, 3, 0, 1, 2, 3, 4]
    assert reader.torn == 1
    assert len(parts_of(path)) == 2


def test_a_line_break_inside_a_payload_stays_one_line() -> None:
    payload = measurement(3).model_dump_json(indent=2).encode()
    line = mirror_line(1, "measurement", payload)
    assert b"\n" not in line
    assert from_json(line)["message"] == from_json(payload)


def test_parts_end_by_size_and_the_oldest_go(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    limits = Bounds(part_bytes=4096, total_bytes=16384, free_bytes=0)
    path = tmp_path / CAPTURE
    with caplog.at_level(logging.WARNING):
        log = record(path, 500, limits)
        log.close()
    on_disk = sum(p.stat().st_size for p in parts_of(path))
    assert on_disk <= limits.total_bytes
    assert log.parts_dropped > 0
    assert log.written == 500
    assert "part dropped" in caplog.text
    reader, messages = read(path)
    assert reader.parts_missing == log.parts_dropped
    kept = [m.k for m in messages]
    assert kept == list(range(kept[0], 500))


@pytest.mark.parametrize("part_bytes", [1024, 20_000, 64 * 2**20])
def test_all_parts_together_never_exceed_their_bound(tmp_path: Path, part_bytes: int) -> None:
    limits = Bounds(part_bytes=part_bytes, total_bytes=20_000, free_bytes=0)
    path = tmp_path / CAPTURE
    log = RotatingLog(path, {"loop": "x" * 300}, limits, LOG)
    most, least = 0, limits.total_bytes
    for k in range(1000):
        log.write(line_of(measurement(k)))
        log.flush()
        on_disk = sum(p.stat().st_size for p in parts_of(path))
        assert on_disk <= limits.total_bytes
        most = max(most, on_disk)
        least = min(least, on_disk) if log.parts_dropped else least
    log.close()
    assert least > limits.total_bytes - 3 * limits.of_a_part
    assert most > limits.total_bytes - limits.total_bytes // 2
    assert [m.k for m in read(path)[1]][-1] == 999
    assert len(parts_of(path)) > 1


def test_a_line_that_no_bound_has_room_for_is_dropped_alone(tmp_path: Path) -> None:
    limits = Bounds(part_bytes=1024, total_bytes=4096, free_bytes=0)
    log = record(tmp_path / CAPTURE, 3, limits)
    log.write(b"x" * 5000)
    log.close()
    assert (log.dropped, log.parts_dropped) == (1, 0)
    assert [m.k for m in read(tmp_path)[1]] == [0, 1, 2]


def test_a_header_that_no_bound_has_room_for_pauses_the_recording(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    limits = Bounds(part_bytes=1024, total_bytes=2048, free_bytes=0)
    log = RotatingLog(tmp_path / CAPTURE, {"loop": "x" * 3000}, limits, LOG)
    log.write(line_of(measurement(0)))
    log.close()
    assert (log.paused, log.dropped, log.first_part) == (True, 1, 0)
    assert "no room for a header" in caplog.text
    assert parts_of(tmp_path / CAPTURE) == []


def test_a_full_disk_pauses_the_recording_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = [10**9]
    monkeypatch.setattr(RotatingLog, "free_bytes", lambda _self: free[0])
    monkeypatch.setattr(RotatingLog, "LOOK_AT_DISK_S", 0.0)
    log = RotatingLog(tmp_path / CAPTURE, {}, Bounds(free_bytes=10**6), LOG)
    with caplog.at_level(logging.INFO):
        log.write(line_of(measurement(0)))
        free[0] = 10
        log.write(line_of(measurement(1)))
        log.write(line_of(measurement(2)))
        assert (log.paused, log.dropped) == (True, 2)
        free[0] = 10**9
        log.write(line_of(measurement(3)))
    log.close()
    assert (log.paused, log.dropped) == (False, 2)
    assert [m.k for m in read(tmp_path)[1]] == [0, 3]
    assert caplog.text.count("recording paused") == 1
    assert "recording again, 2 lines were dropped" in caplog.text


def test_a_disk_that_others_fill_costs_no_part_of_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RotatingLog, "LOOK_AT_DISK_S", 0.0)
    path = tmp_path / CAPTURE
    log = record(path, 100, Bounds(part_bytes=2048, free_bytes=0))
    log.close()
    before = {p: p.read_bytes() for p in parts_of(path)}
    assert len(before) > 5
    monkeypatch.setattr(RotatingLog, "free_bytes", lambda _self: 10)
    log = RotatingLog(path, {"loop": "loop"}, Bounds(part_bytes=2048, free_bytes=1000), LOG)
    log.write(line_of(measurement(100)))
    log.close()
    assert (log.paused, log.dropped, log.parts_dropped) == (True, 1, 0)
    assert before.items() <= {p: p.read_bytes() for p in parts_of(path)}.items()


@pytest.mark.parametrize("written", [None, 0, 10])
def test_a_header_that_cannot_be_written_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: int | None
) -> None:
    put = os.write

    def full(file: int, block: bytes) -> int:
        if written is None:
            raise OSError(errno.ENOSPC, "No space left on device")
        return put(file, block[:written])

    monkeypatch.setattr(RotatingLog, "LOOK_AT_DISK_S", 0.0)
    path = tmp_path / CAPTURE
    log = record(path, 3)
    log.flush()
    monkeypatch.setattr(os, "write", full)
    log.write(line_of(measurement(3)))
    log.flush()
    files = len(list(Path("/dev/fd").iterdir()))
    for _ in range(50):
        log.write(line_of(measurement(4)))
    assert (log.paused, log.dropped) == (True, 51)
    assert len(list(Path("/dev/fd").iterdir())) == files
    assert parts_of(path) == [path]
    monkeypatch.setattr(os, "write", put)
    log.write(line_of(measurement(5)))
    log.close()
    assert parts_of(path) == [path, part_path(path, 1)]
    assert [m.k for m in read(path)[1]] == [0, 1, 2, 5]


def test_a_part_without_a_header_is_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / CAPTURE
    for _ in range(5):
        record(path, 3).close()
    path.write_bytes(b"")
    part_path(path, 1).write_bytes(b'{"event":"hea')
    part_path(path, 3).write_bytes(line_of(measurement(9)) + b"\n" + line_of(measurement(9)))
    reader, messages = read(path)
    assert [m.k for m in messages] == [0, 1, 2] * 2
    assert (reader.torn, reader.parts_missing) == (4, 0)


def test_a_block_that_the_disk_cuts_short_is_counted_line_by_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = record(tmp_path / CAPTURE, 5, ROOMY)
    log.flush()
    for k in range(5, 10):
        log.write(line_of(measurement(k)))
    room = 2 * len(line_of(measurement(5))) + 10
    put = os.write
    monkeypatch.setattr(os, "write", lambda file, block: put(file, block[:room]))
    log.flush()
    assert (log.written, log.dropped, log.paused) == (7, 3, True)
    monkeypatch.undo()
    log.close()
    reader, messages = read(tmp_path)
    assert [m.k for m in messages] == list(range(7))
    assert reader.torn == 1


def test_reading_follows_a_capture_that_grows_and_rotates(tmp_path: Path) -> None:
    limits = Bounds(part_bytes=2048, total_bytes=10**6, free_bytes=0)
    log = RotatingLog(tmp_path / CAPTURE, {}, limits, LOG)
    reader = CaptureReader(tmp_path)
    seen = []
    for k in range(100):
        log.write(line_of(measurement(k)))
        if k % 7 == 0:
            log.flush()
            seen += [m.k for m in of_the_loop(reader)]
    log.close()
    seen += [m.k for m in of_the_loop(reader)]
    assert seen == list(range(100))
    assert reader.behind_bytes == 0
    assert len(parts_of(tmp_path / CAPTURE)) > 3


def test_what_is_not_read_yet_is_told_in_steps_of_two_messages(tmp_path: Path) -> None:
    log = RotatingLog(
        tmp_path / CAPTURE, {}, Bounds(part_bytes=10**6, total_bytes=10**7, free_bytes=0), LOG
    )
    for k in range(400):
        log.write(line_of(measurement(k)))
    log.close()
    reader = CaptureReader(tmp_path)
    told = [reader.behind_steps for _ in of_the_loop(reader)]
    for read_so_far in (100, 200, 300):
        assert told[read_so_far - 1] == pytest.approx((400 - read_so_far) / 2, rel=0.05)
    assert reader.behind_steps == 0


def test_a_reader_whose_part_was_dropped_is_not_ahead_of_the_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / CAPTURE
    record(path, 1000, Bounds(part_bytes=180_000, free_bytes=0)).close()
    first, second = parts_of(path)
    assert first.stat().st_size > second.stat().st_size
    monkeypatch.setattr(recording, "READ_BYTES", first.stat().st_size)
    reader = CaptureReader(path)
    pending = [next(of_the_loop(reader)).k for _ in range(10)]
    first.unlink()
    assert reader.behind_bytes > second.stat().st_size
    pending += [m.k for m in of_the_loop(reader)]
    assert pending == list(range(1000))
    assert reader.behind_bytes == 0


def test_a_reader_whose_last_parts_were_dropped_waits_with_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / CAPTURE
    record(path, 100).close()
    reader = CaptureReader(path)
    list(reader.records())
    path.unlink()
    assert reader.behind_bytes == 0
    part_path(path, 1).write_bytes(b"x")
    assert reader.behind_bytes == 1


KNOWN: dict[str, Any] = {"loop": "loop", "knowledge": {"A": [[0.1, 1e300]]}, "view": {"loss": 0.0}}


@pytest.mark.parametrize(
    ("later", "expected"),
    [
        ({"knowledge": {"A": [[0.2, 1e300]]}}, "knowledge: differs from the first part's"),
        ({"view": {"loss": 0.1}}, "view: differs from the first part's"),
        ({"loop": "other"}, "loop: differs from the first part's"),
        ({"capture_version": 1}, "capture_version: got 1, expected 2"),
    ],
)
def test_a_part_of_other_settings_is_told_and_not_mixed_in(
    tmp_path: Path, later: dict[str, object], expected: str
) -> None:
    path = tmp_path / CAPTURE
    RotatingLog(path, KNOWN, ROOMY, LOG).close()
    live = CaptureReader(path)
    second = RotatingLog(path, KNOWN | later, ROOMY, LOG)
    second.write(line_of(measurement(7)))
    second.close()
    for read_it in (lambda: CaptureReader(path), lambda: list(live.records())):
        with pytest.raises(CaptureError) as error:
            read_it()
        assert str(error.value).startswith(f"{part_path(path, 1)}: line 1: {expected}")
        assert "\n" not in str(error.value)


def test_a_tap_that_starts_again_with_other_eavesdroppers_goes_on(tmp_path: Path) -> None:
    for names in (["oracle"], ["learning"]):
        log = RotatingLog(tmp_path / CAPTURE, KNOWN | {"eavesdroppers": names}, ROOMY, LOG)
        log.write(line_of(measurement(len(names[0]))))
        log.close()
    assert [m.k for m in read(tmp_path)[1]] == [6, 8]


def test_one_who_listens_begins_after_the_parts_of_other_settings(tmp_path: Path) -> None:
    path = tmp_path / CAPTURE
    bound = {"knowledge": {"h": [float("inf")]}}
    for k, header in enumerate([KNOWN | bound, KNOWN, KNOWN | {"capture_version": 9}]):
        log = RotatingLog(path, header, ROOMY, LOG)
        log.write(line_of(measurement(k)))
        log.close()
    with pytest.raises(CaptureError, match="no part with these settings"):
        CaptureReader(path, KNOWN)
    for k in (3, 4):
        log = RotatingLog(path, KNOWN | bound, ROOMY, LOG)
        log.write(line_of(measurement(k)))
        log.close()
    reader = CaptureReader(path, KNOWN | bound)
    assert [m.k for m in of_the_loop(reader)] == [3, 4]
    assert reader.parts_missing == 0


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "no such capture"),
        (b"", "line 1: expected a header"),
        (b"not json\n", "line 1: expected a header"),
        (b'{"event":"header","format":"wyner-trace","version":1,"vantage":"plant"}\n', "got None"),
        (
            b'{"format":"wyner-trace","vantage":"tap","capture_version":9}\n',
            "capture_version: got 9, expected 2",
        ),
    ],
)
def test_what_is_no_capture_is_refused_in_one_line(
    tmp_path: Path, content: bytes | None, expected: str
) -> None:
    path = tmp_path / "capture.jsonl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CaptureError, match=expected) as error:
        CaptureReader(path)
    assert "\n" not in str(error.value)
