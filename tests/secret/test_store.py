"""The key store: confirmed before delivered, delivered once, nothing of what was erased left."""

import os
import random
import sqlite3
import subprocess
import sys
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import pytest
from protocol.secret.records import (
    BlockRow,
    Key,
    KeysRefused,
    Side,
    StoreError,
    TooFewKeys,
    UnknownKeys,
    key_id,
)
from runtime.keys.anchor import Anchor
from runtime.keys.key_maker import KeyMaker
from runtime.keys.store import KeyStore

from protocol.secret.blocks import ClosedBlock
from tests.support.giving import deliver, deliver_named

SESSION = "0123456789abcdef"


def row(number: int, keys: int, state: str = "stored") -> BlockRow:
    return BlockRow(SESSION, number, 44, 44, 88, keys + 1, keys, state, 1)


def bodies(number: int, count: int) -> list[bytes]:
    return [random.Random(f"{number}/{i}").randbytes(32) for i in range(count)]


def store(path: Path, side: Side = "controller") -> KeyStore:
    return KeyStore(path / f"{side}.sqlite3", side, create=True)


def test_both_ends_hold_the_same_keys_in_disjoint_halves(tmp_path: Path) -> None:
    with store(tmp_path) as controller, store(tmp_path, "plant") as plant:
        for end in (controller, plant):
            for number, count in ((0, 1), (1, 14)):
                end.add(row(number, count), bodies(number, count))
                end.confirm(SESSION, number)
        assert controller.ids() == plant.ids()
        assert (controller.available(), plant.available()) == (8, 7)
        for giver, taker in ((controller, plant), (plant, controller)):
            given = deliver(giver, giver.available(), "one", partner=taker)
            ids = [key.key_id for key in reversed(given)]
            assert deliver_named(taker, ids, partner=giver) == given[::-1]
        assert controller.counts() == plant.counts() == (0, 0, 15, 0, 0)


def test_the_oldest_key_comes_first_and_ids_name_block_and_row(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 3), bodies(0, 3))
        keys.confirm(SESSION, 0)
        first, third = deliver(keys, 2)
        assert first == Key(key_id(SESSION, 0, 1), bodies(0, 3)[0])
        assert third.key_id == key_id(SESSION, 0, 3)
        assert bodies(0, 3)[0].hex() not in repr(first)


def test_an_unconfirmed_key_is_not_given_but_found_by_its_id(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 4), bodies(0, 4))
        assert keys.available() == 0
        with pytest.raises(TooFewKeys, match=r"^number: got 1, expected at most the 0 keys"):
            deliver(keys)
        (found,) = deliver_named(keys, [key_id(SESSION, 0, 2)])
        assert found.key == bodies(0, 4)[1]


def test_all_or_none(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 5), bodies(0, 5))
        keys.confirm(SESSION, 0)
        with pytest.raises(TooFewKeys) as few:
            deliver(keys, 4)
        assert (few.value.asked, few.value.available) == (4, 3)
        wanted = [key_id(SESSION, 0, 2), key_id(SESSION, 0, 3), "nothing"]
        with pytest.raises(UnknownKeys) as unknown:
            deliver_named(keys, wanted)
        assert unknown.value.ids == (key_id(SESSION, 0, 3), "nothing")  # 3 is of its own half
        assert len(deliver(keys, 3)) == 3
        assert len(deliver_named(keys, [key_id(SESSION, 0, 2)] * 2)) == 1
        with pytest.raises(UnknownKeys):
            deliver_named(keys, [key_id(SESSION, 0, 2)])


def test_a_block_is_added_once_whatever_became_of_it(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        assert keys.add(row(0, 2), bodies(0, 2), tag="ab")
        keys.confirm(SESSION, 0)
        deliver(keys, 1)
        before = keys.ids()
        assert not keys.add(row(0, 2), bodies(0, 2), tag="cd")
        assert keys.ids() == before
        assert keys.block_tag(SESSION, 0) == ("confirmed", "ab", 2)
        assert keys.block_tag(SESSION, 1) is None


def test_a_block_that_differs_is_erased(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 2), bodies(0, 2))
        keys.drop(SESSION, 0)
        keys.confirm(SESSION, 0)
        assert keys.counts() == (0, 0, 0, 2, 0)
        with pytest.raises(UnknownKeys):
            deliver_named(keys, [key_id(SESSION, 0, 2)])


def test_no_byte_of_a_delivered_or_dropped_key_stays_in_the_file(tmp_path: Path) -> None:
    keys = store(tmp_path)
    for number in range(4):
        keys.add(row(number, 40), bodies(number, 40))
        (keys.drop if number == 3 else keys.confirm)(SESSION, number)
    delivered = deliver(keys, 30)
    whole = b"".join(path.read_bytes() for path in tmp_path.iterdir())
    assert not any(key.key in whole for key in delivered)
    assert not any(body in whole for body in bodies(3, 40))
    assert bodies(2, 40)[39] in whole
    keys.close()


def test_the_file_is_its_owners_only(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        with store(tmp_path / "folder") as keys, keys.transaction():
            modes = {p.name: p.stat().st_mode & 0o777 for p in (tmp_path / "folder").iterdir()}
    finally:
        os.umask(before)
    assert set(modes.values()) == {0o600}


def test_a_refused_store_gives_nothing(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 2), bodies(0, 2))
        keys.confirm(SESSION, 0)
        keys.refuse("seed 7: its keys are predictable")
        keys.refuse("another reason")
    with store(tmp_path) as keys:
        assert keys.available() == 0
        with pytest.raises(KeysRefused, match=r"^seed 7: its keys are predictable$"):
            deliver(keys, 1)
        with pytest.raises(KeysRefused, match=r"^seed 7"):
            deliver_named(keys, [])


def test_a_full_store_drops_the_oldest_keys_its_own_half_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("runtime.keys.store.MOST_KEYS", 3)
    with store(tmp_path) as keys:
        for number in range(5):
            keys.add(row(number, 4), bodies(number, 4))
            keys.confirm(SESSION, number)
        assert keys.available() == 3
        states = dict(keys.ids())
        assert [states[key_id(SESSION, 4, r)] for r in (1, 3)] == ["confirmed"] * 2
        partners = [states[key_id(SESSION, b, r)] for b in range(5) for r in (2, 4)]
        assert partners == ["dropped"] * 4 + ["confirmed"] * 6


@pytest.mark.slow
def test_a_block_costs_the_same_however_many_keys_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted in steps of SQLite's machine, a hundred at a time."""
    monkeypatch.setattr("runtime.keys.store.MOST_KEYS", 2000)
    monkeypatch.setattr("runtime.keys.store.TOMBSTONES", 9000)
    with store(tmp_path) as keys:
        steps: list[int] = []
        for number in range(160):
            spent: list[int] = []
            keys.db.set_progress_handler(partial(spent.append, 0), 100)
            keys.add(row(number, 84), bodies(0, 84))
            keys.confirm(SESSION, number)
            steps.append(len(spent))
        assert keys.counts().dropped == 3000
        assert len(keys.ids()) == 9000
        assert max(steps[-20:]) < 2 * steps[4]


def test_what_is_no_store_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no key store is there"):
        KeyStore(tmp_path / "none", "plant")
    (tmp_path / "text").write_text("not a database, but long enough to be looked at as one" * 20)
    with pytest.raises(StoreError, match=r"^[^\n]*not a key store[^\n]*$"):
        KeyStore(tmp_path / "text", "plant")
    store(tmp_path).close()
    with pytest.raises(StoreError, match="side: got 'controller', expected 'plant'"):
        KeyStore(tmp_path / "controller.sqlite3", "plant")


def test_a_copy_of_a_file_in_use_whose_index_does_not_fit_is_refused_at_the_start(
    tmp_path: Path,
) -> None:
    path = tmp_path / "controller.sqlite3"
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        ((root,),) = keys.rows("SELECT rootpage FROM sqlite_master WHERE name = 'key_ready'")
        ((size,),) = keys.rows("PRAGMA page_size")
        page = slice((root - 1) * size, root * size)
        before = path.read_bytes()[page]
        keys.confirm(SESSION, 0)
    torn = bytearray(path.read_bytes())
    assert torn[page] != before
    torn[page] = before
    path.write_bytes(torn)
    with pytest.raises(StoreError, match=r"^[^\n]*not a key store: [^\n]*key_ready$"):
        store(tmp_path)


def test_whoever_has_a_store_open_leaves_one_alone_that_is_put_in_its_place(
    tmp_path: Path,
) -> None:
    """SQLite finds its journal by name: the old file's pages would come into the new one."""
    path = tmp_path / "controller.sqlite3"
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        keys.confirm(SESSION, 0)
        copy = path.read_bytes()
        path.rename(tmp_path / "moved")
        for copied in (False, True):
            if copied:
                path.write_bytes(copy)
            with pytest.raises(StoreError, match="another one is in its place: start again"):
                keys.available()
            with pytest.raises(StoreError, match="another one is in its place: start again"):
                keys.set_aside("served x", 1)
    with store(tmp_path) as keys:
        assert keys.available() == 4


def test_an_older_copy_gives_nothing_twice(tmp_path: Path) -> None:
    path = tmp_path / "controller.sqlite3"
    beside = Anchor(path).path
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        keys.confirm(SESSION, 0)
        deliver(keys, 1)
    older, count = path.read_bytes(), beside.read_bytes()
    with store(tmp_path) as keys:
        deliver(keys, 1)
    newer = path.read_bytes()
    path.write_bytes(older)
    with pytest.raises(StoreError, match=r"^[^\n]*has given 1 times, [^\n]* counts 2: one of the"):
        store(tmp_path)
    path.unlink()
    with pytest.raises(StoreError, match="has given 0 times"):
        store(tmp_path)
    path.write_bytes(newer)
    store(tmp_path).close()
    beside.write_bytes(count)
    with pytest.raises(StoreError, match=r"has given 2 times, and controller[^ ]* counts 1"):
        store(tmp_path)
    beside.write_bytes(b"x")
    with pytest.raises(StoreError, match=r"^[^\n]*-given: not as it was written"):
        store(tmp_path)
    beside.unlink()
    with pytest.raises(StoreError, match=r"^[^\n]*-given: is gone"):
        store(tmp_path)


def test_a_process_that_dies_over_a_delivery_can_go_on(tmp_path: Path) -> None:
    path = tmp_path / "controller.sqlite3"
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        keys.confirm(SESSION, 0)
        Anchor(path).announce(1)  # and dies before the store has it
    with store(tmp_path) as keys, pytest.MonkeyPatch.context() as dying:
        dying.setattr(Anchor, "count", lambda _anchor, _given: None)
        first = deliver(keys, 1)  # and dies before it has said so
    with store(tmp_path) as keys:
        assert deliver(keys, 1) != first
        assert keys.available() == 2


def test_what_a_dead_process_gave_counts_from_the_next_opening_on(tmp_path: Path) -> None:
    path = tmp_path / "controller.sqlite3"
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        keys.confirm(SESSION, 0)
    older = path.read_bytes()
    with store(tmp_path) as keys, pytest.MonkeyPatch.context() as dying:
        dying.setattr(Anchor, "count", lambda _anchor, _given: None)
        deliver(keys, 1)
    store(tmp_path).close()
    path.write_bytes(older)
    with pytest.raises(StoreError, match=r"has given 0 times, and [^ ]* counts 1"):
        store(tmp_path)


def test_a_copy_that_is_put_back_under_an_open_store_gives_nothing(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        keys.confirm(SESSION, 0)
        Anchor(tmp_path / "controller.sqlite3").count(7)
        with pytest.raises(StoreError, match="keys would be given twice"):
            deliver(keys, 1)
        assert keys.available() == 3  # one was set aside


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("column", ["body", "row", "own", "id"])
def test_a_key_that_is_not_as_it_was_written_is_not_given(
    tmp_path: Path, column: str, named: bool
) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 8), bodies(0, 8))
        keys.confirm(SESSION, 0)
        other = {"body": bodies(1, 1)[0], "row": 3, "own": 1, "id": key_id(SESSION, 0, 9)}[column]
        place = 2 if column == "own" else 1
        keys.db.execute(f"UPDATE key SET {column} = ? WHERE place = ?", (other, place))
        if not named:
            wrong = rf"the key at place {place} is not as it was written"
            with pytest.raises(StoreError, match=wrong):
                deliver(keys, 2)
            return
        keys.db.execute("UPDATE key SET own = 0 WHERE place = 1")
        name = other if column == "id" else key_id(SESSION, 0, 1)
        with pytest.raises(StoreError, match="is not as it was written"):
            deliver_named(keys, [str(name)])


def test_notes_and_blocks_are_seen_to_be_as_they_were_written(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.add(row(0, 2), bodies(0, 2), tag="ab")
        for table, column in (("block", "tag"), ("meta", "value")):
            keys.db.execute(f"UPDATE {table} SET {column} = 'x'")
        for ask in (
            lambda: keys.block_tag(SESSION, 0),
            lambda: keys.assumption or keys.note("side"),
        ):
            with pytest.raises(StoreError, match="is not as it was written"):
                ask()
    with pytest.raises(StoreError, match="its note 'version' is not as it was written"):
        store(tmp_path)


def test_a_store_that_cannot_be_read_any_more_says_so(tmp_path: Path) -> None:
    with store(tmp_path) as keys:
        keys.db.execute("DROP TABLE key")
        for ask in (keys.available, keys.counts, keys.ids):
            with pytest.raises(StoreError, match=r"^[^\n]*controller.sqlite3: [^\n]*$"):
                ask()


def test_a_damaged_file_whose_error_quotes_no_text_is_a_line(tmp_path: Path) -> None:
    store(tmp_path).close()
    path = tmp_path / "controller.sqlite3"
    whole = path.read_bytes()
    for place in range(whole.index(b"CREATE TABLE"), len(whole), 97):
        path.write_bytes(whole[:place] + b"\xfa" + whole[place + 1 :])
        with suppress(StoreError):
            store(tmp_path).close()


def test_a_new_store_makes_no_key_of_a_block_that_began_before_it(tmp_path: Path) -> None:
    """One that was removed may have given them."""
    nonces = tuple(bodies(9, 8))
    with store(tmp_path) as keys:
        keys.begin(SESSION, 5)
        key_maker = KeyMaker(keys)
        for number, first, made in ((1, 3, 0), (2, 5, 5), (3, 9, 5)):
            closed = ClosedBlock(SESSION, number, 4, 4, 8, 6, nonces, first + 3)
            stored = key_maker.make_keys(closed)
            assert (stored.keys, stored.older, bool(stored.tag)) == (made, not made, bool(made))
        assert key_maker.make_keys(ClosedBlock("another", 0, 4, 4, 8, 6, nonces, 4)).keys == 5
        assert keys.counts().stored == 15


KILLED = """
import os, sys
from pathlib import Path
from runtime.keys.giving import Giver
from runtime.keys.store import KeyStore
from tests.support.giving import consent
keys = KeyStore(Path(sys.argv[1]), "controller")
giver = Giver(keys, look=lambda: consent(keys))
while True:
    for key in giver.deliver(1, "one"):
        os.write(1, (key.key_id + "\\n").encode())
"""


@pytest.mark.slow
def test_a_key_is_delivered_once_through_kill_9(tmp_path: Path) -> None:
    path = tmp_path / "controller.sqlite3"
    with store(tmp_path) as keys:
        for number in range(40):
            keys.add(row(number, 80), bodies(number, 80))
            keys.confirm(SESSION, number)
    given: list[str] = []
    for _ in range(3):
        command = [sys.executable, "-c", KILLED, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for _ in range(40):
                given.append(process.stdout.readline().strip())
            process.kill()
            given += [line.strip() for line in process.stdout if line.endswith("\n")]
    assert len(given) == len(set(given)) >= 120
    with closing(sqlite3.connect(path)) as db, db:
        (buried,) = db.execute("SELECT COUNT(*) FROM key WHERE state = 'delivered'").fetchone()
    db.close()
    assert len(given) <= buried <= len(given) + 3  # killed between the burial and the word


@pytest.mark.parametrize(
    ("spoil", "same"),
    [
        ("UPDATE key SET body = NULL WHERE row = 1", True),  # delivered here
        ("UPDATE key SET body = zeroblob(32) WHERE row = 2", False),
        ("DELETE FROM key WHERE row = 2", False),
        ("UPDATE key SET place = 100 WHERE row = 3", False),
    ],
)
def test_two_stores_are_compared_where_they_lie(tmp_path: Path, spoil: str, same: bool) -> None:
    with (
        store(tmp_path) as mine,
        KeyStore(tmp_path / "plant.sqlite3", "plant", create=True) as theirs,
    ):
        for one in (mine, theirs):
            one.add(row(0, 8), bodies(0, 8))
            one.confirm(SESSION, 0)
        theirs.rows(spoil)
        assert mine.same_as(theirs) == same
        assert theirs.same_as(mine) == same
