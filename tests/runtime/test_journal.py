"""Journals: what was saved survives kill -9, one process at a time, and only its own scenario."""

import os
import resource
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from protocol.agreement import NO_SYMBOL
from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Offer, SendCommand
from runtime.journal import ControllerJournal, PlantJournal
from runtime.journal_files import JournalError
from tests.support.patience import PATIENCE_S
from tests.support.twin_journals import NO_STEP, step_of

SCENARIO = "f" * 64
SESSION = "0123456789abcdef"
RECEIVER = ReceiverRecord(
    session=SESSION, k=4, x=(0.1, -0.2), u=(3.0,), applied_k=3, x_after=(1e-17, 2.0)
)
SENDER = SenderRecord(
    session=SESSION,
    ended=("fedcba9876543210",),
    state=(2, 1),
    k=9,
    applied_k=8,
    transitions=7,
    p=3,
    cipher=1,
    message_symbol=0,
    framed=True,
    offset=5,
    x=(0.1 + 0.2, 5e-324),
    offer=Offer(session=SESSION, k=9, candidates=((1 / 3,), (-2.0,)), cipher=1),
)


# --- records --------------------------------------------------------------------------------------


def test_records_come_back_to_the_last_bit(tmp_path: Path) -> None:
    with ControllerJournal(tmp_path / "c", SCENARIO) as journal:
        assert journal.load() is None
        journal.save(Actions(record=SENDER))
    with ControllerJournal(tmp_path / "c", SCENARIO) as journal:
        assert journal.load() == SENDER
    with PlantJournal(tmp_path / "p", SCENARIO) as journal2:
        assert journal2.load() is None
        journal2.save(Actions(record=RECEIVER))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal2:
        assert journal2.load() == RECEIVER


def test_the_last_save_counts(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        for k in range(100):
            journal.save(Actions(record=RECEIVER._replace(k=k)))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        record = journal.load()
        assert record is not None
        assert record.k == 99


def test_the_symbols_of_a_frame_are_kept_in_order_and_dropped_with_it(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        for chunk in ("100", "11", ""):
            journal.save(Actions(record=RECEIVER, chunk=chunk))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.chunks() == "10011"
        journal.save(Actions(record=RECEIVER, drop_chunks=True, received=b"whole"))
        assert journal.chunks() == ""
        journal.save(Actions(record=RECEIVER, chunk="1", drop_chunks=True))
        assert journal.chunks() == "1"
        assert journal.inbox() == [b"whole"]


def test_the_inbox_gives_the_newest_oldest_first(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        for i in range(10):
            journal.save(Actions(record=RECEIVER, received=b"%d" % i, drop_chunks=True))
        assert journal.inbox(3) == [b"7", b"8", b"9"]


def test_a_message_is_queued_once_and_in_order(tmp_path: Path) -> None:
    with ControllerJournal(tmp_path / "c", SCENARIO) as journal:
        assert journal.enqueue(SendCommand(id="a", payload=b"first"))
        assert journal.enqueue(SendCommand(id="b", payload=bytes(range(256))))
        assert not journal.enqueue(
            SendCommand(id="a", payload=b"another text, the same identifier")
        )
    with ControllerJournal(tmp_path / "c", SCENARIO) as journal:
        assert journal.queued == 2
        assert [journal.payload(i) for i in range(3)] == [b"first", bytes(range(256)), None]
        assert journal.identifier(1) == "b"
        assert journal.enqueue(SendCommand(id="c", payload=b"third"))
        assert journal.payload(2) == b"third"
        assert journal.queued_as("a") == b"first"
        assert journal.queued_as("d") is None


# --- steps ----------------------------------------------------------------------------------------

MEASUREMENT = Measurement(session=SESSION, k=5, x=(0.1 + 0.2, 7.0), applied_k=4, x_after=(1.0, 2.0))
OFFER = Offer(session=SESSION, k=4, candidates=((1 / 3,), (5e-324,)), cipher=1)


def test_a_step_comes_back_with_the_record_before_it(tmp_path: Path) -> None:
    with ControllerJournal(tmp_path / "c", SCENARIO) as journal:
        assert step_of(journal) == NO_STEP
        journal.save(Actions(record=SENDER))
        journal.save(Actions(offer=OFFER, measurement=MEASUREMENT))
    with ControllerJournal(tmp_path / "c", SCENARIO) as journal:
        assert journal.load() == SENDER
        assert step_of(journal) == (OFFER, NO_SYMBOL, MEASUREMENT)
        # what was loaded can be built on
        journal.save(Actions(offer=OFFER, measurement=MEASUREMENT))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal2:
        journal2.save(Actions(record=RECEIVER, chunk="10"))
        journal2.save(Actions(offer=OFFER, coin=1, measurement=MEASUREMENT))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal2:
        assert journal2.load() == RECEIVER
        assert step_of(journal2) == (OFFER, 1, MEASUREMENT)
        assert journal2.chunks() == "10"


def test_a_staged_record_is_written_with_the_next_step_and_a_saved_one_ends_it(
    tmp_path: Path,
) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        journal.save(Actions(record=RECEIVER))
        journal.save(Actions(offer=OFFER, coin=1, measurement=MEASUREMENT))
        with pytest.raises(AssertionError, match="not been counted"):
            journal.save(Actions(offer=OFFER, coin=1, measurement=MEASUREMENT))
        journal.save(Actions(record=RECEIVER._replace(k=5), later=True))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.load() == RECEIVER
        assert step_of(journal) == (OFFER, 1, MEASUREMENT)
        journal.save(Actions(record=RECEIVER._replace(k=5), later=True))
        journal.save(Actions(offer=OFFER, coin=0, measurement=MEASUREMENT))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.load() == RECEIVER._replace(k=5)
        assert step_of(journal) == (OFFER, 0, MEASUREMENT)
        journal.save(Actions(record=RECEIVER._replace(k=6)))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.load() == RECEIVER._replace(k=6)
        assert step_of(journal) == NO_STEP


@pytest.mark.parametrize("wrong", [b"{}", b"not json", MEASUREMENT.wire()])
def test_a_step_that_is_none_is_refused(tmp_path: Path, wrong: bytes) -> None:
    offer = OFFER.model_copy()
    offer.__dict__["_bytes"] = wrong
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        journal.save(Actions(record=RECEIVER))
        journal.save(Actions(offer=offer, coin=0, measurement=MEASUREMENT))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal, pytest.raises(JournalError) as error:
        journal.load()
    assert "record" in one_line(error, tmp_path / "p")


# --- what it refuses ------------------------------------------------------------------------------


def one_line(error: pytest.ExceptionInfo[JournalError], path: Path) -> str:
    text = str(error.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


@pytest.mark.slow
def test_two_processes_cannot_hold_one_journal(tmp_path: Path) -> None:
    path = tmp_path / "c"
    code = (
        "import sys; from pathlib import Path; from runtime.journal import *\n"
        "try: ControllerJournal(Path(sys.argv[1]), sys.argv[2])\n"
        "except JournalError as error: print(error)\n"
    )
    with ControllerJournal(path, SCENARIO):
        second = subprocess.run(
            [sys.executable, "-c", code, str(path), SCENARIO],
            capture_output=True,
            text=True,
            check=True,
            timeout=PATIENCE_S,
        )
    assert second.stdout.strip() == f"{path}: another process is using it"
    with ControllerJournal(path, SCENARIO):
        pass


def test_another_scenario_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        journal.save(Actions(record=RECEIVER))
    with pytest.raises(JournalError) as error:
        PlantJournal(tmp_path / "p", "0" * 64)
    assert "scenario: got" in one_line(error, tmp_path / "p")
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.load() == RECEIVER


def test_the_other_sides_journal_is_refused(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO):
        pass
    with pytest.raises(JournalError) as error:
        ControllerJournal(tmp_path / "p", SCENARIO)
    assert "kind: got 'plant', expected 'controller'" in one_line(error, tmp_path / "p")


def test_what_is_no_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c"
    path.write_bytes(b"These are not the bytes of a database." * 100)
    with pytest.raises(JournalError) as error:
        ControllerJournal(path, SCENARIO)
    assert "not a journal" in one_line(error, path)
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalError) as error:
        ControllerJournal(tmp_path / "file" / "c", SCENARIO)
    assert "cannot be opened" in one_line(error, tmp_path / "file" / "c")


@pytest.mark.parametrize(
    "change", ["body = x'7b7d'", "number = 7", "body = NULL", "offer = x'7b7d'", "coin = 1"]
)
def test_a_record_that_was_altered_is_refused(tmp_path: Path, change: str) -> None:
    path = tmp_path / "p"
    with PlantJournal(path, SCENARIO) as journal:
        journal.save(Actions(record=RECEIVER))
    database = sqlite3.connect(path)
    database.execute(f"UPDATE record SET {change}")
    database.commit()
    database.close()
    with pytest.raises(JournalError) as error:
        PlantJournal(path, SCENARIO)
    assert "not as it was written" in one_line(error, path)


@pytest.mark.parametrize(
    "change",
    ["payload = x'62'", "number = 3", "id = 'n'", "payload = 7"],
)
def test_a_message_that_was_altered_is_not_sent(tmp_path: Path, change: str) -> None:
    path = tmp_path / "c"
    with ControllerJournal(path, SCENARIO) as journal:
        journal.enqueue(SendCommand(id="m", payload=b"a"))
    database = sqlite3.connect(path)
    database.execute(f"UPDATE outbox SET {change}")
    database.commit()
    database.close()
    with ControllerJournal(path, SCENARIO) as journal, pytest.raises(JournalError):
        journal.payload(0)


# --- kill -9 --------------------------------------------------------------------------------------

WRITER = """
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from protocol.link.peer import Actions
from runtime.journal import PlantJournal
from protocol.messages import Measurement, Offer
from protocol.link.records import ReceiverRecord

def count(record):
    record = record._replace(k=record.k + 1, p=record.p + 1)
    if record.p % 50 == 0:
        journal.save(Actions(record=record, drop_chunks=True, received=b"%d" % record.p))
    elif record.p % 7 == 0:
        journal.save(Actions(record=record, chunk="1"))
    else:
        journal.save(Actions(record=record, later=True))
    return record

journal = PlantJournal(Path(sys.argv[1]), sys.argv[2])
record = journal.load()
if record is None:
    record = ReceiverRecord(session="0123456789abcdef", k=0, x=(0.5,), u=(0.0,))
    journal.save(Actions(record=record))
if journal.offer is not None:
    record = count(record)
while True:
    offer = Offer(session=record.session, k=record.k, candidates=((1.0,), (2.0,)), cipher=0)
    measurement = Measurement(
        session=record.session, k=record.k + 1, x=(0.5,), applied_k=record.k, x_after=(0.5,)
    )
    journal.save(Actions(offer=offer, coin=record.k % 2, measurement=measurement))
    sys.stdout.write(f"{measurement.k}\\n")
    sys.stdout.flush()
    record = count(record)
"""


@pytest.mark.slow
def test_what_a_killed_writer_acknowledged_is_there(tmp_path: Path) -> None:
    path = tmp_path / "p"
    for lines in (1, 37, 150, 400):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), SCENARIO],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert writer.stdout is not None
        acknowledged = 0
        for _ in range(lines):
            acknowledged = int(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
        rest = [line for line in writer.stdout.read().split("\n")[:-1] if line]
        writer.wait(PATIENCE_S)
        writer.stdout.close()
        if rest:
            acknowledged = int(rest[-1])
        with PlantJournal(path, SCENARIO) as journal:
            record, (offer, coin, measurement) = journal.load(), step_of(journal)
            assert record is not None
            assert record.k + (offer is not None) in (acknowledged, acknowledged + 1)
            if offer is not None:
                assert offer.k == record.k
                assert measurement is not None
                assert measurement.k == record.k + 1
                assert coin == record.k % 2
            # all or nothing: the symbols and messages are those of this very record
            whole, since = divmod(record.k, 50)
            assert record.p == record.k
            assert len(journal.inbox(10**6)) == whole
            first = 50 * whole + 1
            chunks = sum(p % 7 == 0 for p in range(first, first + since))
            assert len(journal.chunks()) == chunks


@contextmanager
def no_file_grows() -> Iterator[None]:
    """As on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_journal_that_cannot_be_written_any_more_names_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "j"
    with PlantJournal(path, SCENARIO) as journal:
        journal.save(Actions(record=RECEIVER))
        pwrite = os.pwrite
        with monkeypatch.context() as full:
            full.setattr(os, "pwrite", lambda file, data, at: pwrite(file, data[:40], at))
            with pytest.raises(JournalError, match="No space left") as error:
                journal.save(Actions(offer=OFFER, coin=1, measurement=MEASUREMENT))
        one_line(error, tmp_path / "j-steps")
        journal.save(Actions(offer=OFFER, coin=0, measurement=MEASUREMENT))  # over what was torn
        with no_file_grows(), pytest.raises(JournalError) as error:
            journal.save(Actions(record=RECEIVER, chunk="01"))
        one_line(error, path)
    with PlantJournal(path, SCENARIO) as journal:
        journal.load()
        assert step_of(journal) == (OFFER, 0, MEASUREMENT)
