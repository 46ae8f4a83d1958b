"""The process beside the mirror: what it waits for, and how it ends."""

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

import pytest

from protocol.messages import TapStatus
from runtime.recording import Bounds
from runtime.run_folder import ANALYSIS_GUESSES, CAPTURE
from studies.secrecy.runs import Run, simulate
from tap_service import analysis, listening
from tap_service.analysis import Assignment, analyse
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


def record(run: Run, run_dir: Path, view: View) -> None:
    log = RotatingLog(run_dir / CAPTURE, header(run, view), Bounds(free_bytes=0), LOG)
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


def test_it_waits_for_a_capture_of_its_own_settings(
    run: Run, tmp_path: Path, heard: list[object]
) -> None:
    record(run, tmp_path, View(loss=0.5))
    with started(run, tmp_path) as pipe:
        assert not pipe.poll(0.1)
        record(run, tmp_path, View())
        while len(heard) < len(run.messages):  # she may have caught up with its first line
            assert status_when_caught_up(pipe).unused.dropped == 0
    assert heard == list(run.messages)


def test_it_ends_also_while_it_waits(run: Run, tmp_path: Path, heard: list[object]) -> None:
    with started(run, tmp_path) as pipe:
        pipe.send("finish")
        assert pipe.poll(20.0)
        assert pipe.recv_bytes() == b"null"
    assert heard == []
