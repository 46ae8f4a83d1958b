"""Journals whose last write was torn or damaged: the state before it, or after it, or one line."""

import re
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord
from protocol.messages import Measurement, Offer
from protocol.secret.nonces import Contribution
from runtime import journal_files
from runtime.journal import ControllerJournal, PlantJournal
from runtime.journal_files import JOURNAL_VERSION, JournalError
from runtime.step_log import Entry, StepLog
from tests.support.twin_journals import NO_STEP, SCENARIO, copied, step_of

SESSION: Final = "0123456789abcdef"
RECORD: Final = ReceiverRecord(session=SESSION, k=0, x=(0.5,), u=(0.0,))
NAME: Final = "journal.sqlite3"


def offer(k: int) -> Offer:
    return Offer(session=SESSION, k=k, candidates=((1.0,), (2.0,)), cipher=0)


def measurement(k: int) -> Measurement:
    return Measurement(session=SESSION, k=k + 1, x=(0.5,), applied_k=k, x_after=(0.25,))


def row(k: int) -> Contribution:
    return Contribution(k, 1, bytes([k]) * 32, None if k % 2 else bytes([k + 100]) * 32)


def steps(journal: PlantJournal, first: int, last: int) -> None:
    """Steps as a plant that makes keys writes them: each record with the row of the step before."""
    for k in range(first, last):
        record = RECORD._replace(k=k)
        journal.save(Actions(record=record, later=True, contribution=row(k - 1) if k else None))
        journal.save(Actions(offer=offer(k), coin=k % 2, measurement=measurement(k)))


def state(path: Path) -> Any:
    """All that a journal says when it is opened."""
    with PlantJournal(path, SCENARIO) as journal:
        record = journal.load()
        contributions = journal.contributions(SESSION)
        return (
            record,
            step_of(journal),
            journal.chunks(),
            journal.inbox(),
            contributions,
        )


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def put(folder: Path, files: dict[str, bytes]) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / NAME


def changed(before: bytes, after: bytes) -> range:
    """Where a write was: from the first byte that differs to the last."""
    differs = [i for i in range(len(after)) if before[i : i + 1] != after[i : i + 1]]
    return range(differs[0], differs[-1] + 1)


def torn(before: bytes, after: bytes, every: int = 1) -> Iterator[bytes]:
    """The file with each beginning of the write, and with each byte of it flipped."""
    place = changed(before, after)
    for end in place[::every]:
        yield after[:end] + before[end:]
    for i in place[::every]:
        for mask in (0x01, 0xFF):
            yield after[:i] + bytes([after[i] ^ mask]) + after[i + 1 :]


def tried(folder: Path, files: dict[str, bytes], name: str, versions: Iterator[bytes]) -> list[Any]:
    """What the journal says with each version of one of its files; None for one clear line."""
    found = []
    for content in versions:
        path = put(folder, files | {name: content})
        try:
            found.append(state(path))
        except JournalError as error:
            assert str(error).startswith(f"{folder}/{NAME}")
            assert "\n" not in str(error)
            found.append(None)
    return found


def test_a_torn_or_flipped_step_is_not_there_byte_by_byte(tmp_path: Path) -> None:
    path, tag = tmp_path / "steps", b"8 bytes."
    written = [
        Entry(k, b"record", offer(k).wire(), measurement(k).wire(), k % 2, row(k) if k else None)
        for k in range(3)
    ]
    log = StepLog(path, tag)

    def append(k: int) -> None:
        log.append(k, b"record", offer(k), k % 2, measurement(k), row(k) if k else None)

    append(0)
    append(1)
    before = path.read_bytes()
    append(2)
    after = path.read_bytes()
    assert log.read(-1) == written
    versions = list(torn(before, after))
    assert len(versions) > 1000
    for version in versions:
        path.write_bytes(version)
        assert log.read(-1) == written[:2]
        assert path.read_bytes() == before
        append(2)
        assert path.read_bytes() == after
    log.close()


def test_steps_that_a_rare_write_has_are_zeros_however_far_it_came(tmp_path: Path) -> None:
    path = tmp_path / "steps"
    log = StepLog(path, b"8 bytes.")
    for k in range(3):
        log.append(k, b"record", offer(k), k % 2, measurement(k))
    full = path.read_bytes()
    log.clear()
    assert path.read_bytes() == bytes(len(full))
    log.append(3, b"record")
    once = path.read_bytes()
    assert once.endswith(bytes(len(full) - log.size))
    assert log.read(2) == [Entry(3, b"record")]
    for end in range(len(full) + 1):  # killed in the midst of it
        path.write_bytes(bytes(end) + full[end:])
        assert log.read(2) == []
        assert path.read_bytes() == b""
    log.close()


def test_a_step_is_before_or_after_whatever_byte_of_it_is_torn_or_flipped(tmp_path: Path) -> None:
    live = tmp_path / "live" / NAME
    with PlantJournal(live, SCENARIO) as journal:
        steps(journal, 0, 5)
        before = contents(live.parent)
        steps(journal, 5, 6)
        after = contents(live.parent)
    name = f"{NAME}-steps"
    assert {file for file in after if after[file] != before[file]} == {name}
    folder = tmp_path / "try"
    states = [state(put(folder, files)) for files in (before, after)]
    assert [s[0].k for s in states] == [4, 5]
    assert [len(s[-1]) for s in states] == [4, 5]
    found = tried(folder, after, name, torn(before[name], after[name], every=23))
    assert len(found) > 50
    assert all(one in (states[0], None) for one in found)
    assert states[0] in found


@pytest.mark.parametrize("cleared", [False, True])
def test_a_rare_write_is_before_or_after_too(tmp_path: Path, cleared: bool) -> None:
    """It goes to the database first; a death before the steps are cleared changes nothing."""
    live = tmp_path / "live" / NAME
    with PlantJournal(live, SCENARIO) as journal:
        steps(journal, 0, 5)
        before = contents(live.parent)
        kept = Actions(
            record=RECORD._replace(k=5), chunk="01", contribution=row(4), obsolete_rows=(range(2),)
        )
        journal.save(kept)
        after = contents(live.parent)
    name = f"{NAME}-wal"
    assert after[f"{NAME}-steps"].strip(b"\0") == b""
    files = after if cleared else after | {f"{NAME}-steps": before[f"{NAME}-steps"]}
    folder = tmp_path / "try"
    states = [state(put(folder, files)) for files in (before, files)]
    assert states[1] == (kept.record, NO_STEP, "01", [], [row(2), row(3), row(4)])
    if not cleared:
        found = tried(folder, files, name, torn(before[name], after[name], every=97))
        assert all(one in (*states, None) for one in found)
        assert states[0] in found


def test_damage_before_the_last_step_is_told(tmp_path: Path) -> None:
    live = tmp_path / "live" / NAME
    with PlantJournal(live, SCENARIO) as journal:
        steps(journal, 0, 3)
        path = copied(live, tmp_path / "copy")
    log = path.with_name(f"{NAME}-steps")
    whole = log.read_bytes()
    middle = len(whole.rstrip(b"\0")) // 2
    log.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    with pytest.raises(JournalError) as error:
        PlantJournal(path, SCENARIO)
    line = rf"{log}: byte \d+: not a step, but whole steps follow it"
    assert re.fullmatch(line, str(error.value))
    log.write_bytes(whole)
    assert state(path)[0].k == 2


def written(journal: Path) -> int:
    """Bytes of its steps, without what was made ready for more."""
    data = journal.with_name(f"{journal.name}-steps").read_bytes()
    return len(data.rstrip(b"\0"))


def test_what_was_made_ready_is_no_step(tmp_path: Path) -> None:
    live = tmp_path / "live" / NAME
    with PlantJournal(live, SCENARIO) as journal:
        steps(journal, 0, 3)
        killed = copied(live, tmp_path / "copy")
        size = written(killed)
    lengths = [path.with_name(f"{NAME}-steps").stat().st_size for path in (live, killed)]
    assert lengths[0] == size < lengths[1]
    assert state(killed) == state(live)
    assert killed.with_name(f"{NAME}-steps").stat().st_size == size
    with PlantJournal(killed, SCENARIO) as journal:
        assert journal.load() == RECORD._replace(k=2)
        journal.save(Actions(record=RECORD._replace(k=3), later=True))
        journal.save(Actions(offer=offer(3), coin=1, measurement=measurement(3)))
        assert state(copied(killed, tmp_path / "again"))[0].k == 3


def test_steps_of_another_journal_or_that_do_not_follow_are_left_out(tmp_path: Path) -> None:
    one, two = tmp_path / "one" / NAME, tmp_path / "two" / NAME
    for path, last in ((one, 5), (two, 3)):
        with PlantJournal(path, SCENARIO) as journal:
            steps(journal, 0, last)
    log = one.with_name(f"{NAME}-steps")
    shutil.copyfile(two.with_name(log.name), log)
    assert state(one)[0].k == 0  # the record as the database has it
    with PlantJournal(two, SCENARIO) as journal:
        journal.load()
        old = copied(two, tmp_path / "old")
        journal.save(Actions(record=RECORD._replace(k=3), chunk="1"))
        steps(journal, 4, 6)
        shutil.copyfile(two.with_name(log.name), old.with_name(log.name))
    assert state(old)[2] == ""
    assert state(old)[0].k == 0
    assert state(two)[2] == "1"


def test_a_long_run_of_steps_is_put_into_the_database(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_files, "LARGEST_STEP", 5000)
    path = tmp_path / NAME
    with PlantJournal(path, SCENARIO) as journal:
        steps(journal, 0, 60)
        assert 0 < written(copied(path, tmp_path / "sixty")) < 6000
        record = RECORD._replace(k=60)
        journal.save(Actions(record=record, later=True, contribution=row(59)))
        for k in range(60, 90):  # begun and read in two writes
            journal.save(Actions(offer=offer(k), coin=1))
            assert state(copied(path, tmp_path / f"{k}"))[1] == (offer(k), 1, None)
            journal.save(Actions(offer=offer(k), coin=1, measurement=measurement(k)))
            journal.save(Actions(record=RECORD._replace(k=k + 1), later=True, contribution=row(k)))
    found = state(path)
    assert found[0].k == 89
    assert found[-1] == [row(k) for k in range(89)]


def test_a_link_in_the_place_of_the_steps_is_refused(tmp_path: Path) -> None:
    path = tmp_path / NAME
    path.with_name(f"{NAME}-steps").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(JournalError, match="not a regular file") as error:
        PlantJournal(path, SCENARIO)
    assert str(error.value).startswith(f"{path}-steps: ")
    assert "\n" not in str(error.value)


def test_an_older_journal_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / NAME
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT)")
    database.execute("CREATE TABLE record (id INTEGER PRIMARY KEY, body BLOB, heard BLOB)")
    told = {"kind": "controller", "version": "6", "scenario": SCENARIO}
    database.executemany("INSERT INTO meta VALUES (?, ?)", told.items())
    database.commit()
    database.close()
    for _ in range(2):
        with pytest.raises(JournalError) as error:
            ControllerJournal(path, SCENARIO)
        assert str(error.value) == f"{path}: version: got '6', expected '{JOURNAL_VERSION}'"
