"""Journals: what was saved survives kill -9 and more, one process at a time, one scenario only."""

import resource
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest

from protocol.link.distiller import KeyRows
from protocol.link.effects import Save
from protocol.link.records import INITIAL_ID, Loaded
from protocol.link.step import Answered, Begun, Read
from protocol.messages import Measurement, Offer, SendCommand
from protocol.secret.nonces import Contribution
from protocol.secret.stream import NOTHING_HELD, BlockKeys, Held, Part
from runtime import journal as journals
from runtime.journal import (
    BATCH,
    REMEMBERED,
    ControllerJournal,
    JournalError,
    PlantJournal,
)
from tests.support.journals import copied
from tests.support.patience import PATIENCE_S
from tests.support.programs import python
from tests.support.records import changed, controller_record, plant_record

SCENARIO = "f" * 64
SESSION = "0123456789abcdef"
RECEIVER = plant_record(
    session=SESSION, k=4, x=(0.1, -0.2), u=(3.0,), applied_k=3, x_after=(1e-17, 2.0)
)
SENDER = controller_record(
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


# --- what it holds --------------------------------------------------------------------------------

MEASUREMENT = Measurement(session=SESSION, k=5, x=(0.1 + 0.2, 7.0), applied_k=4, x_after=(1.0, 2.0))
OFFER = Offer(session=SESSION, k=4, candidates=((1 / 3,), (5e-324,)), cipher=1)
PART = Part(block=3, first=4, digits=bytes(range(7)))
KEYS = BlockKeys(block=3, first=11, keys=bytes(range(64)))


def row(j: int) -> Contribution:
    return Contribution(j, 1, bytes([j]) * 32, None if j % 2 else bytes([j + 100]) * 32)


@pytest.mark.parametrize("in_memory", [False, True])
def test_all_comes_back_to_the_last_bit(tmp_path: Path, in_memory: bool) -> None:
    controller = ControllerJournal(None if in_memory else tmp_path / "c", SCENARIO)
    plant = PlantJournal(None if in_memory else tmp_path / "p", SCENARIO)
    assert controller.load() == Loaded()
    assert plant.load() == Loaded()
    controller.save(Save(SENDER, rows=KeyRows((row(4), row(5)), keys=(KEYS,), part=PART)))
    plant.save(Save(changed(RECEIVER, stored=3), symbols="100"))
    plant.save(Save(changed(RECEIVER, stored=5), symbols="11", step=Begun(OFFER, 1)))
    assert plant.load() == Loaded(changed(RECEIVER, stored=5), Begun(OFFER, 1), symbols="10011")
    controller.save(Save(SENDER, step=Answered(MEASUREMENT, OFFER), rows=KeyRows(part=PART)))
    step = Save(RECEIVER, step=Read(OFFER, 1, MEASUREMENT))
    plant.save(step)
    if not in_memory:
        controller.close()
        plant.close()
        controller = ControllerJournal(controller.path, SCENARIO)
        plant = PlantJournal(plant.path, SCENARIO)
    rows = (row(4), row(5))
    held = Held(PART, (KEYS,))
    assert controller.load() == Loaded(SENDER, Answered(MEASUREMENT, OFFER), rows, held)
    assert plant.load() == Loaded(RECEIVER, Read(OFFER, 1, MEASUREMENT)), "the frame is over"
    plant.save(Save(changed(RECEIVER, k=5)))
    assert plant.load() == Loaded(changed(RECEIVER, k=5)), "a record takes the step's place"
    controller.close()
    plant.close()


def test_blocks_that_are_over_at_once_may_meet_in_a_batch(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        for j in range(1, 3 * BATCH):
            journal.save(Save(RECEIVER, rows=KeyRows((row(j),))))
        both = (range(2, BATCH + 3), range(BATCH + 3, BATCH + 6))
        journal.save(Save(RECEIVER, rows=KeyRows(obsolete_rows=both)))
        left = [1, *range(BATCH + 6, 3 * BATCH)]
        assert [one.j for one in journal.load().rows] == left


def test_keys_and_digits_shrink_and_go_and_with_their_session(tmp_path: Path) -> None:
    """What was erased is in no file of the journal any more."""
    secret, key = b"digits that have served", b"a key that was used" * 2
    path = tmp_path / "p"
    with PlantJournal(path, SCENARIO) as journal:
        keys, part = BlockKeys(0, 9, key + bytes(64)), Part(0, 0, secret)
        other = BlockKeys(1, 0, key[::-1])
        journal.save(Save(RECEIVER, rows=KeyRows(keys=(keys, other), part=part)))
        assert journal.load().held == Held(part, (keys, other))
        part, keys = Part(0, 7, secret[7:]), BlockKeys(0, 20, bytes(64))
        journal.save(Save(RECEIVER, rows=KeyRows(keys=(keys,), part=part)))
        assert journal.load().held == Held(part, (keys, other))
        journal.save(Save(RECEIVER, rows=KeyRows(keys=(other._replace(keys=b""),))))
        assert journal.load().held == Held(keys=(keys,))
    for gone in (secret, secret[7:], key, key[::-1]):
        assert gone not in path.read_bytes()
    with PlantJournal(path, SCENARIO) as journal:
        journal.save(Save(changed(RECEIVER, session="fedcba9876543210")))
        assert journal.load().held == NOTHING_HELD


def test_the_message_received_last_is_kept_and_no_other(tmp_path: Path) -> None:
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.last_message() is None
        for payload in (b"the first of them", b"", b"the last"):
            journal.save(Save(RECEIVER, received=payload))
    with PlantJournal(tmp_path / "p", SCENARIO) as journal:
        assert journal.last_message() == b"the last"
    assert b"the first of them" not in (tmp_path / "p").read_bytes()


def send(journal: ControllerJournal, name: str, payload: bytes, delivered: int = 0) -> None:
    record = changed(SENDER, message=delivered)
    journal.save(Save(record, queued=SendCommand(id=name, payload=payload), durable=True))


def test_a_message_that_was_delivered_is_gone_and_its_identifier_is_known(tmp_path: Path) -> None:
    secret = b"nobody else may know"
    path = tmp_path / "c"
    with ControllerJournal(path, SCENARIO) as journal:
        send(journal, INITIAL_ID, secret)
        send(journal, "next", b"waits")
        journal.save(Save(changed(SENDER, message=1)))
        assert journal.payload(0) is None
        assert journal.waiting() == [(1, "next", b"waits")]
        assert journal.crc_of(INITIAL_ID) == crc32(secret)
    assert secret not in path.read_bytes()
    with ControllerJournal(path, SCENARIO) as journal:
        assert (journal.queued, journal.crc_of(INITIAL_ID)) == (2, crc32(secret))


def test_a_long_run_of_messages_and_steps_takes_no_more_room(tmp_path: Path) -> None:
    """All that was there is zeros, in the write-ahead log too, once that has gone round."""
    path, sizes = tmp_path / "c", set()
    with ControllerJournal(path, SCENARIO) as journal:
        for number in range(3 * REMEMBERED):
            payload = b"message number %d " % number * 10
            send(journal, f"m{number}", payload, delivered=number)
            journal.save(Save(changed(SENDER, message=number + 1, k=number)))
            if number > 2 * REMEMBERED:
                sizes.add(path.stat().st_size)
        log = path.with_name("c-wal").read_bytes()
        assert len(log) < 5_000_000
        assert journal.crc_of("m0") is None
        assert journal.crc_of(f"m{2 * REMEMBERED}") is not None
    assert max(sizes) < 300_000
    assert max(sizes) - min(sizes) < 20_000
    assert b"message number" not in path.read_bytes()
    assert b"message number 1500 " not in log


# --- durable saves --------------------------------------------------------------------------------

TRACED = r"""
import os, sys
from pathlib import Path
from protocol.link.distiller import KeyRows
from protocol.link.effects import Save
from protocol.link.records import ControllerRecord, LinkRecord
from runtime.journal import ControllerJournal
with ControllerJournal(Path(sys.argv[1]), "f" * 64) as journal:
    for k in range(50):
        journal.save(Save(ControllerRecord(link=LinkRecord(k=k)), durable=k in (20, 30)))
        os.write(2, b"%d\n" % k)
    os.write(2, b"over\n")
"""


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace shows the syncs")
def test_a_durable_save_is_one_sync_and_any_other_none(tmp_path: Path) -> None:
    log = tmp_path / "calls"
    calls = ["strace", "-o", str(log), "-e", "trace=fsync,fdatasync,write"]
    program = [sys.executable, "-c", TRACED, str(tmp_path / "c")]
    subprocess.run([*calls, *program], check=True, timeout=PATIENCE_S, stderr=subprocess.DEVNULL)
    steps = log.read_text().split('write(2, "')
    syncs = {int(part.split("\\n")[0]): part.count("sync(") for part in steps[1:-1]}
    assert {k + 1 for k, count in syncs.items() if count} == {20, 30}
    assert set(syncs.values()) == {0, 1}


def test_another_boot_of_the_machine_is_told_unless_the_journal_was_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boot = tmp_path / "boot"
    monkeypatch.setattr(journals, "BOOT_ID", boot)
    boot.write_text("one\n")
    with PlantJournal(tmp_path / "live" / "p", SCENARIO) as journal:
        journal.save(Save(RECEIVER))
        killed = copied(tmp_path / "live" / "p", tmp_path / "killed")
        again = copied(tmp_path / "live" / "p", tmp_path / "again")
    with PlantJournal(killed, SCENARIO) as journal:
        assert journal.load() == Loaded(RECEIVER)
    boot.write_text("another\n")
    for path, fell_back in ((killed, False), (tmp_path / "live" / "p", False), (again, True)):
        with PlantJournal(path, SCENARIO) as journal:
            assert journal.load() == Loaded(RECEIVER, fell_back=fell_back)
    boot.unlink()
    with PlantJournal(again, SCENARIO) as journal:
        assert not journal.load().fell_back


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
        second = python("-c", code, path, SCENARIO)
    assert second.stdout.strip() == f"{path}: another process is using it"
    with ControllerJournal(path, SCENARIO):
        pass


ALTERED = "not as it was written"


@pytest.mark.parametrize(
    ("kind", "change", "expected"),
    [
        *(
            (PlantJournal, f"step SET {change}", ALTERED)
            for change in (
                "step = x'7b7d'",
                "id = 7",
                "step = NULL",
                "step = zeroblob(40)",
                "check_ = 1",
            )
        ),
        *(
            (ControllerJournal, f"outbox SET {change}", ALTERED)
            for change in ("payload = x'62'", "number = 3", "id = 'n'", "payload = 7")
        ),
        (PlantJournal, "meta SET value = '6' WHERE name = 'version'", "version: got '6', expected"),
        (
            PlantJournal,
            "meta SET value = 'x' WHERE name = 'kind'",
            "kind: got 'x', expected 'plant'",
        ),
        (PlantJournal, "meta SET value = 'x' WHERE name = 'scenario'", "scenario: got"),
    ],
)
def test_a_journal_that_was_altered_or_is_another_is_refused(
    tmp_path: Path, kind: type[PlantJournal | ControllerJournal], change: str, expected: str
) -> None:
    path = tmp_path / "j"
    with kind(path, SCENARIO) as journal:
        if isinstance(journal, ControllerJournal):
            send(journal, "m", b"a")
        else:
            journal.save(Save(RECEIVER))
    database = sqlite3.connect(path)
    database.execute(f"UPDATE {change}")
    database.commit()
    database.close()
    for _ in range(2):
        with pytest.raises(JournalError) as error:
            kind(path, SCENARIO)
        assert expected in one_line(error, path)


def test_what_is_no_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c"
    path.write_bytes(b"These are not the bytes of a database." * 100)
    with pytest.raises(JournalError) as error:
        ControllerJournal(path, SCENARIO)
    assert "not a journal" in one_line(error, path)
    with pytest.raises(JournalError) as error:
        ControllerJournal(path / "c", SCENARIO)
    assert "cannot be opened" in one_line(error, path / "c")


# --- disks ----------------------------------------------------------------------------------------


@contextmanager
def no_file_grows() -> Iterator[None]:
    """As on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("durable", [False, True])
def test_a_journal_that_cannot_be_written_any_more_names_its_file(
    tmp_path: Path, durable: bool
) -> None:
    path = tmp_path / "j"
    step = Save(RECEIVER, step=Read(OFFER, 1, MEASUREMENT), durable=durable)
    with PlantJournal(path, SCENARIO) as journal:
        journal.save(Save(RECEIVER))
        with no_file_grows(), pytest.raises(JournalError) as error:
            journal.save(step)
        one_line(error, path)
        assert journal.load() == Loaded(RECEIVER)
        journal.save(step)
    with PlantJournal(path, SCENARIO) as journal:
        assert journal.load().step == step.step


def state(path: Path) -> Any:
    """All that a journal says when it is opened; None for one clear line."""
    try:
        with PlantJournal(path, SCENARIO) as journal:
            return journal.load(), journal.last_message()
    except JournalError as error:
        assert str(error).startswith(f"{path}: ")
        assert "\n" not in str(error)
        return None


def rewritten(before: bytes, after: bytes) -> range:
    """Where a write was: from the first byte that differs to the last."""
    differs = [i for i in range(len(after)) if before[i : i + 1] != after[i : i + 1]]
    return range(differs[0], differs[-1] + 1)


def test_a_torn_or_flipped_save_is_not_there_or_told(tmp_path: Path) -> None:
    """Cut at many places, and many bytes of it flipped: the state before it, or one line."""
    live = tmp_path / "live" / "journal"
    with PlantJournal(live, SCENARIO) as journal:
        journal.save(Save(RECEIVER, rows=KeyRows((row(1),)), symbols="0101"))
        before = copied(live, tmp_path / "before")
        step = Save(RECEIVER, step=Read(OFFER, 1, MEASUREMENT))
        journal.save(step._replace(rows=KeyRows((row(2),)), received=b"whole"))
        after = copied(live, tmp_path / "after")
    log = "journal-wal"
    old, new = (path.with_name(log).read_bytes() for path in (before, after))
    assert before.read_bytes() == after.read_bytes()
    place = rewritten(old, new)
    versions = [new[:end] + old[end:] for end in place[::41]]
    versions += [new[:i] + bytes([new[i] ^ 0x41]) + new[i + 1 :] for i in place[::37]]
    assert len(versions) > 200
    states = [
        state(copied(path, tmp_path / f"{path.parent.name} read")) for path in (before, after)
    ]
    assert [len(s[0].rows) for s in states] == [1, 2]
    for i, version in enumerate(versions):
        path = copied(after, tmp_path / f"{i}")
        path.with_name(log).write_bytes(version)
        assert state(path) in (states[0], None), i
