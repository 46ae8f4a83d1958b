"""What the programs share: pace, words for fingerprints, atomic files, throttling, stopping."""

import logging
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol import files
from protocol.files import write_atomically, write_status
from protocol.runtime.process import (
    Pace,
    RateLimitedLog,
    Throttle,
    UsageError,
    logger,
    new_id,
    proquint,
    stop_on_signals,
)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("realtime", 0.1), ("x1", 0.1), ("x10", 0.01), ("x0.5", 0.2), ("fast", None)],
)
def test_pace(text: str, seconds: float | None) -> None:
    assert Pace(text).step_s(0.1) == (None if seconds is None else pytest.approx(seconds))
    assert Pace(text).text == text


@pytest.mark.parametrize(
    "text", ["", "x", "10", "x0", "x-1", "xinf", "xnan", "xx2", "Fast", "slow"]
)
def test_a_pace_that_is_none_is_one_line(text: str) -> None:
    with pytest.raises(ValueError, match="expected realtime, fast, or xN") as caught:
        Pace(text)
    assert repr(text) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("address", "words"),  # the examples of the proposal, arXiv:0901.4016
    [
        ("7f000001", "lusab-babad"),  # 127.0.0.1
        ("3f54dcc1", "gutih-tugad"),  # 63.84.220.193
        ("3f760723", "gutuk-bisog"),  # 63.118.7.35
        ("8c62c18d", "mudof-sakat"),  # 140.98.193.141
        ("40ff06c8", "haguz-biram"),  # 64.255.6.200
        ("801e342d", "mabiv-gibot"),  # 128.30.52.45
        ("93437702", "natag-lisaf"),  # 147.67.119.2
    ],
)
def test_fingerprints_as_words(address: str, words: str) -> None:
    assert proquint(address, words=2) == words


def test_different_groups_are_different_words() -> None:
    assert len({proquint(f"{value:04x}", words=1) for value in range(2**16)}) == 2**16


def test_ids_are_random_and_well_formed() -> None:
    ids = {new_id() for _ in range(100)}
    assert len(ids) == 100
    assert all(len(i) == 16 and int(i, 16) >= 0 for i in ids)


# --- files ----------------------------------------------------------------------------------------


Write = Callable[[Path, bytes], None]

WAYS: list[Write] = [write_atomically, write_status]


@pytest.mark.parametrize("write", WAYS)
def test_a_file_is_replaced_whole(tmp_path: Path, write: Write) -> None:
    path = tmp_path / "status.json"
    write(path, b"older")
    write(path, b"old")
    write(path, b"new, and longer")
    assert path.read_bytes() == b"new, and longer"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    beside = {path.with_name(".spare-status.json")} if write is write_status else set()
    assert {*path.parent.iterdir()} == {path, *beside}


def test_a_status_takes_the_place_of_the_one_before_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "status.json"
    for data in (b"first", b"second"):
        write_status(path, data)
    before = {file.stat().st_ino for file in tmp_path.iterdir()}
    monkeypatch.setattr(files, "READ_S", 0.0)
    for data in (b"third, and longer", b"4"):
        write_status(path, data)
        assert path.read_bytes() == data
        assert {file.stat().st_ino for file in tmp_path.iterdir()} == before


def test_whoever_has_opened_a_status_reads_it_though_two_more_are_written(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    write_status(path, b"first")
    write_status(path, b"second")
    with path.open("rb") as reader:
        for data in (b"third", b"4"):
            write_status(path, data)
        assert reader.read() == b"second"


def test_a_status_for_which_there_is_no_room_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "status.json"
    write_status(path, b"old")
    monkeypatch.setattr(os, "write", lambda _file, data: len(data) - 1)
    with pytest.raises(OSError, match="No space left"):
        write_status(path, b"new")
    assert path.read_bytes() == b"old"


def test_a_status_is_replaced_where_names_cannot_be_exchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "_renameat2", None)
    for data in (b"old", b"new"):
        write_status(tmp_path / "f", data)
    assert (tmp_path / "f").read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [tmp_path / "f"]


def test_what_a_killed_writer_left_of_a_status_harms_nobody(tmp_path: Path) -> None:
    (tmp_path / ".spare-f").write_bytes(b"half of something long")
    write_status(tmp_path / "f", b"new")
    assert (tmp_path / "f").read_bytes() == b"new"


@pytest.mark.parametrize("replace", WAYS)
def test_readers_never_see_a_part(tmp_path: Path, replace: Write) -> None:
    path = tmp_path / "status"
    contents = [bytes([i]) * 100_000 for i in range(2)]
    replace(path, contents[0])
    done = threading.Event()

    def write() -> None:
        for i in range(200):
            replace(path, contents[i % 2])
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    seen = set()
    while not done.is_set():
        seen.add(path.read_bytes())  # and never that it is not there
    writer.join()
    assert seen <= set(contents)


# --- once a second --------------------------------------------------------------------------------


def test_a_throttle_opens_once_a_period() -> None:
    throttle = Throttle(1.0)
    assert [t for t in (0.0, 0.5, 0.999, 1.0, 1.5, 3.0, 3.9, 4.0) if throttle.ready(t)] == [
        0.0,
        1.0,
        3.0,
        4.0,
    ]


def test_complaints_are_counted_and_logged_once_a_second(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    log = logging.getLogger("test-complaints")
    complaints = RateLimitedLog(log)
    for i in range(1000):
        complaints.add(f"offer {i}: garbage")
    now = 101.0
    complaints.add("offer 1000: garbage")
    assert complaints.total == 1001
    assert [r.message for r in caplog.records] == [
        "offer 0: garbage",
        "offer 1000: garbage (and 999 more since the last such line)",
    ]


def test_a_log_is_made_once() -> None:
    assert logger("test-log") is logger("test-log")
    assert len(logger("test-log").handlers) == 1


# --- stopping -------------------------------------------------------------------------------------


def test_a_signal_sets_the_event_and_a_second_one_raises() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), stop_on_signals() as stopping:
        assert not stopping.is_set()
        os.kill(os.getpid(), signal.SIGTERM)
        assert stopping.wait(5)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    assert signal.getsignal(signal.SIGTERM) is before


STOPS = """
import sys
from protocol.runtime.process import stop_on_signals
with stop_on_signals() as stopping:
    print("ready", flush=True)
    print("stopped" if stopping.wait({wait}) else "still running", flush=True)
"""


def stopping_child(wait: float, **environment: str) -> "subprocess.Popen[str]":
    child = subprocess.Popen(
        [sys.executable, "-c", STOPS.format(wait=wait)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    return child


def test_a_service_stops_when_its_standard_input_ends() -> None:
    with stopping_child(20, WYNER_STOP_WITH_STDIN="1") as child:
        assert child.communicate(timeout=15)[0] == "stopped\n"


def test_without_the_variable_standard_input_does_not_matter() -> None:
    with stopping_child(0.3, WYNER_STOP_WITH_STDIN="") as child:
        assert child.communicate(timeout=15)[0] == "still running\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_service_stops_on_a_signal(number: signal.Signals) -> None:
    with stopping_child(20) as child:
        child.send_signal(number)
        assert child.communicate(timeout=15)[0] == "stopped\n"
        assert child.returncode == 0


HANDED_TO_ANOTHER_THREAD = """
import os, signal, threading
from protocol.runtime.process import stop_on_signals
with stop_on_signals() as stopping:
    threading.Thread(target=threading.Event().wait, daemon=True).start()
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])  # the other thread takes it
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
    stopping.wait()
"""


def test_a_signal_that_another_thread_takes_ends_the_wait() -> None:
    command = [sys.executable, "-c", HANDED_TO_ANOTHER_THREAD]
    assert subprocess.run(command, timeout=20, check=False).returncode == 0


def test_whoever_waits_for_a_stop_waits_no_longer_than_asked() -> None:
    with stop_on_signals() as stopping:
        began = time.monotonic()
        assert not stopping.wait(0.05)
        assert 0.05 <= time.monotonic() - began < 5.0
        threading.Timer(0.01, stopping.set).start()
        assert stopping.wait()
        assert stopping.wait(0.0)


def test_a_usage_error_has_a_line_a_field() -> None:
    assert UsageError("one").lines == ("one",)
    assert UsageError(["a: x", "b: y"]).lines == ("a: x", "b: y")
    assert str(UsageError(["a: x", "b: y"])) == "a: x\nb: y"
