"""Statuses are written beside the loops; no step waits for them, and none ends for them."""

import json
import logging
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from protocol.messages import ControllerStatus, Status
from protocol.messages.management import StepStatus
from runtime.health import HealthFiles, HealthWriter
from runtime.run_folder import CONTROLLER_STATUS
from tests.support.patience import PATIENCE_S
from tests.support.recorded_pair import RecordedPair
from tests.support.statuses import read_status

LOG = logging.getLogger("health files")


def status(transitions: int) -> Status:
    """As much of a status as is looked at."""
    counts: dict[str, Any] = {"transitions": transitions}
    fields: dict[str, Any] = {"t_ns": 0, "phase": "running"}
    return Status.model_construct(**fields, step=StepStatus.model_construct(**counts))


def health(path: Path) -> str:
    return str(json.loads(path.read_bytes())["health"])


class OnDisk(HealthFiles):
    """On a disk that can be held, and that fails where it is told to."""

    def __init__(self, path: Path, held: threading.Event, error: Exception | None = None) -> None:
        super().__init__(path, LOG)
        self.entered = threading.Event()
        self.written: list[int] = []
        self.held, self._error = held, error

    def write(self, status: Status, now_s: float) -> None:
        self.entered.set()
        assert self.held.wait(PATIENCE_S)
        if self._error is not None:
            raise self._error
        self.written.append(status.step.transitions)


def test_nobody_waits_for_a_slow_disk_and_the_newest_status_counts(tmp_path: Path) -> None:
    free, slow = threading.Event(), OnDisk(tmp_path, threading.Event())
    free.set()
    other = OnDisk(tmp_path, free)
    writer = HealthWriter()
    writer.put(slow, status(1))
    assert slow.entered.wait(PATIENCE_S)
    for transitions in range(2, 1000):
        writer.put(slow, status(transitions))
    writer.put(other, status(7))
    assert slow.written == other.written == []
    slow.held.set()
    writer.close(30)
    assert (slow.written, other.written) == ([1, 999], [7])


def full(_file: int, data: bytes) -> int:
    """A disk without room for all of it."""
    return len(data) // 2


@pytest.mark.parametrize("fault", ["folder", "link", "full"])
def test_a_status_that_cannot_be_written_is_logged_once_and_tried_again(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
) -> None:
    path = tmp_path / "status.json"
    files = HealthFiles(path, LOG)
    with monkeypatch.context() as disk, caplog.at_level(logging.INFO):
        if fault == "folder":
            path.mkdir()
        elif fault == "link":
            path.symlink_to("/dev/full")
        else:
            disk.setattr(os, "write", full)
        for t in range(5):
            files.write(status(10 * t), float(t))
        told = [record for record in caplog.records if record.levelno >= logging.ERROR]
        assert len(told) == 1
        assert str(path) in told[0].getMessage()
        assert "the loop goes on, and the status is tried again" in told[0].getMessage()
    if fault == "folder":
        path.rmdir()
    elif fault == "link":
        path.unlink()
    with caplog.at_level(logging.INFO):
        files.write(status(50), 5.0)
        assert "the status is written again" in caplog.text
        assert health(path).startswith("bad: this file could not")
        files.write(status(60), 6.0)
    assert health(path) == "ok: 0 % missed lately"


def test_a_status_begins_with_its_health_and_is_read_without_it(
    tmp_path: Path,
) -> None:
    loop = RecordedPair(tmp_path, name="packed")
    loop.steps(25)
    path = tmp_path / CONTROLLER_STATUS
    assert path.read_bytes().startswith(b'{"health":"')
    assert read_status(path, ControllerStatus).step.transitions > 0
    loop.stop()
