"""A log, and what is written to it once a second at most."""

import logging
import time

import pytest

from runtime.logs import Burst, RateLimitedLog, logger


def test_a_burst_passes_and_then_one_a_period() -> None:
    limit = Burst(2, 1.0)
    times = (100.0, 100.25, 100.5, 101.0, 101.5, 102.0)
    assert [t for t in times if limit.allows(t)] == [100.0, 100.25, 101.0, 102.0]


def test_what_was_not_logged_is_told_once_the_second_is_over_or_at_the_end(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    complaints = RateLimitedLog(logging.getLogger("test-rest"))
    complaints.report_held_back(last=True)
    for i in range(4):
        complaints.add(f"offer {i}: garbage")
    now = 100.9
    complaints.report_held_back()
    assert [r.message for r in caplog.records] == ["offer 0: garbage"]
    now = 101.0
    for _ in range(3):
        complaints.report_held_back()
    told = "offer 3: garbage (and 2 more since the last such line)"
    assert [r.message for r in caplog.records][1:] == [told]
    complaints.add("offer 4: garbage")
    complaints.report_held_back()
    complaints.report_held_back(last=True)
    complaints.report_held_back(last=True)
    assert [r.message for r in caplog.records][2:] == ["offer 4: garbage"]


def test_a_log_is_made_once() -> None:
    assert logger("test-log") is logger("test-log")
    assert len(logger("test-log").handlers) == 1
