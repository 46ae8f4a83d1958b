"""The process beside the mirror: what it skips when it is far behind, and what it waits for."""

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

import pytest

from protocol.messages import TapStatus
from runtime import recording
from runtime.recording import Bounds, parts_of
from runtime.run_folder import ANALYSIS_GUESSES, CAPTURE
from studies.secrecy.runs import Run, simulate
from tap_service import analysis, listening
from tap_service.analysis import Assignment, analyse
from tap_service.capture import reading as capture
from tap_service.capture.channel import View
from tap_service.capture.recording import RotatingLog, malformed_line, mirror_line
from tap_service.capture.transcript import Transcript
from tests.support.patience import PATIENCE_S

LOG = logging.getLogger("test")
NAME = "nearest-centre"


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(300, 11)


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The messages that the process heard; it runs in a thread here."""
    messages: list[object] = []

    class Counting(Transcript):
        def hear(self, message):  # type: ignore[no-untyped-def]
            messages.append(message)
            return super().hear(message)

    monkeypatch.setattr(listening, "Transcript", Counting)
    monkeypatch.setattr(analysis, "SLICE_S", 0.0)
    monkeypatch.setattr(analysis, "REST_RATIO", 0.0)
    monkeypatch.setattr(analysis, "BELIEF_PERIOD_S", 0.01)
    return messages


def header(run: Run, view: View) -> dict[str, object]:
    return {
        "loop": "loop",
        "knowledge": run.scenario.knowledge().model_dump(mode="json"),
        "view": view.model_dump(mode="json"),
    }


def record(run: Run, run_dir: Path, part_bytes: int, view: View) -> None:
    limits = Bounds(part_bytes=part_bytes, free_bytes=0)
    log = RotatingLog(run_dir / CAPTURE, header(run, view), limits, LOG)
    for i, message in enumerate(run.messages):
        log.write(mirror_line(i, message.topic, message.wire()))
        if i % 10 == 0:
            log.write(malformed_line(i, "key", b"?"))
    log.close()


@contextmanager
def started(run: Run, run_dir: Path) -> Iterator[Connection]:
    told = {NAME: run.scenario.knowledge()}
    limits = Bounds(free_bytes=0)
    given = Assignment(run_dir, ANALYSIS_GUESSES, told, limits, header(run, View()))
    mine, hers = Pipe()

    def run_until_nobody_listens() -> None:
        with suppress(EOFError, ConnectionError):
            analyse(given, hers)

    thread = threading.Thread(target=run_until_nobody_listens)
    thread.start()
    try:
        yield mine
    finally:
        mine.close()
        thread.join(PATIENCE_S)
        hers.close()
    assert not thread.is_alive()


def status_when_caught_up(pipe: Connection) -> TapStatus:
    while True:
        assert pipe.poll(20.0)
        status = TapStatus.model_validate_json(json.loads(pipe.recv_bytes())["status"])
        assert status.behind < 1000  # about 300 steps, and no bytes
        if status.behind == 0:
            return status


@pytest.mark.parametrize("part_bytes", [10_000, 10**8])
def test_every_message_is_heard_or_counted_as_skipped(
    run: Run,
    tmp_path: Path,
    heard: list[object],
    monkeypatch: pytest.MonkeyPatch,
    part_bytes: int,
) -> None:
    monkeypatch.setattr(analysis, "FAR_BEHIND", 20_000)
    monkeypatch.setattr(recording, "READ_BYTES", 4000)
    record(run, tmp_path, part_bytes, View())
    lines = sum(p.read_bytes().count(b"\n") - 2 for p in parts_of(tmp_path / CAPTURE))
    readers: list[capture.CaptureReader] = []

    def reader_of(*args: object) -> capture.CaptureReader:
        readers.append(capture.CaptureReader(*args))  # type: ignore[arg-type]
        return readers[-1]

    monkeypatch.setattr(analysis, "CaptureReader", reader_of)
    with started(run, tmp_path) as pipe:
        status = status_when_caught_up(pipe)
    (reader,) = readers
    assert status.dropped == reader.skipped > 0
    assert len(heard) + reader.skipped + reader.malformed + reader.torn == lines
    # it leaves half of what is too much, but for one reading; headers count there
    whole = b"".join(p.read_bytes() for p in parts_of(tmp_path / CAPTURE))
    least = whole[-(analysis.FAR_BEHIND // 2 - recording.READ_BYTES) :].split(b"\n")[1:]
    kept = sum(b'"topic":' in line and b'"message":' in line for line in least)
    assert kept > 10
    assert heard[-kept:] == list(run.messages[-kept:])


def test_it_waits_for_a_capture_of_its_own_settings(
    run: Run, tmp_path: Path, heard: list[object]
) -> None:
    record(run, tmp_path, 10**8, View(loss=0.5))
    with started(run, tmp_path) as pipe:
        assert not pipe.poll(0.1)
        record(run, tmp_path, 10**8, View())
        while len(heard) < len(run.messages):  # she may have caught up with its first line
            assert status_when_caught_up(pipe).dropped == 0
    assert heard == list(run.messages)


def test_it_ends_also_while_it_waits(run: Run, tmp_path: Path, heard: list[object]) -> None:
    with started(run, tmp_path) as pipe:
        pipe.send("finish")
        assert pipe.poll(20.0)
        assert pipe.recv_bytes() == b"null"
    assert heard == []
