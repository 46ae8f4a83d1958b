"""Statuses and health lines are written beside the loops, and no step waits for them."""

import logging
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from protocol.messages import Status
from runtime.health_files import HealthFiles, HealthWriter
from tests.support.patience import PATIENCE_S

LOG = logging.getLogger("health files")


def status(transitions: int) -> Status:
    return cast("Status", SimpleNamespace(transitions=transitions))


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
        self.written.append(status.transitions)


def test_nobody_waits_for_a_slow_disk_and_the_newest_status_counts(tmp_path: Path) -> None:
    free, slow = threading.Event(), OnDisk(tmp_path, threading.Event())
    free.set()
    other = OnDisk(tmp_path, free)
    failed: list[tuple[str, Exception]] = []
    writer = HealthWriter(lambda loop, error: failed.append((loop, error)))
    writer.put("a", slow, status(1))
    assert slow.entered.wait(PATIENCE_S)
    for transitions in range(2, 1000):
        writer.put("a", slow, status(transitions))
    writer.put("b", other, status(7))
    assert slow.written == other.written == []
    slow.held.set()
    writer.close(30)
    assert (slow.written, other.written, failed) == ([1, 999], [7], [])


def test_a_loop_whose_files_fail_is_told_and_the_others_are_written(tmp_path: Path) -> None:
    free = threading.Event()
    free.set()
    failed: dict[str, Exception] = {}
    told = threading.Event()

    def tell(loop: str, error: Exception) -> None:
        failed[loop] = error
        told.set()

    writer = HealthWriter(tell)
    error = OSError("no room")
    writer.put("a", OnDisk(tmp_path, free, error), status(1))
    assert told.wait(PATIENCE_S)
    good = OnDisk(tmp_path, free)
    writer.put("b", good, status(2))
    writer.close(30)
    assert failed == {"a": error}
    assert good.written == [2]


def test_the_last_status_that_is_lost_is_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    held = threading.Event()
    lost = OnDisk(tmp_path, held, OSError("no room"))
    writer = HealthWriter(lambda *_: pytest.fail("nobody goes on"))
    writer.put("a", lost, status(1))
    assert lost.entered.wait(PATIENCE_S)
    threading.Timer(0.05, held.set).start()
    writer.close(30)
    assert "the last status is lost: no room" in caplog.text


def test_a_writer_that_was_never_asked_starts_no_thread_and_ends() -> None:
    before = set(threading.enumerate())
    HealthWriter(lambda *_: None).close(30)
    assert set(threading.enumerate()) <= before
