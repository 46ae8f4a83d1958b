"""Sealed messages in the key store's file: one transaction each, whatever dies around it."""

import sqlite3
from pathlib import Path

import pytest

from protocol.secret.records import BlockRow, KeysRefused, UnknownKeys
from protocol.secret.sealed import Unsealed
from protocol.secret.sealed_book import SealedBook
from protocol.secret.store import KeyStore

TEXT = b"The old mill, at nine."
KEYS = [bytes([row]) * 32 for row in range(1, 13)]


def add_keys(*stores: KeyStore, number: int = 0) -> None:
    for store in stores:
        row = BlockRow("s", number, 256, 256, 512, 13, 12, "stored", 1)
        store.add(row, KEYS, tag="t")
        store.confirm("s", number)


@pytest.fixture
def books() -> tuple[SealedBook, SealedBook]:
    controller, plant = KeyStore(None, "controller"), KeyStore(None, "plant")
    add_keys(controller, plant)
    return SealedBook(controller), SealedBook(plant)


def test_a_message_is_sealed_once_and_opened_once(books: tuple[SealedBook, SealedBook]) -> None:
    controller, plant = books
    assert controller.queue("m", TEXT) == "queued"
    assert controller.queue("m", TEXT) == "queued"
    sealed = controller.next()
    assert sealed is not None
    assert controller.next() == sealed
    assert len(sealed.cipher) == len(TEXT) != 0
    assert sealed.cipher != TEXT
    assert controller.store.available() == 4  # of six of its half
    assert plant.open(sealed)
    assert not plant.open(sealed)
    assert plant.opened() == [("m", TEXT)]
    assert controller.acknowledged("m")
    assert not controller.acknowledged("m")
    assert controller.queue("m", TEXT) == "done"
    assert controller.next() is None
    assert controller.waiting() == 0


def test_one_at_a_time_in_order_and_no_key_twice(books: tuple[SealedBook, SealedBook]) -> None:
    controller, plant = books
    used: list[str] = []
    for name in ("a", "b", "c"):
        controller.queue(name, TEXT + name.encode())
    for name in ("a", "b", "c"):
        sealed = controller.next()
        assert sealed is not None
        assert sealed.identifier == name
        used += sealed.key_ids
        plant.open(sealed)
        controller.acknowledged(name)
    assert len(set(used)) == len(used) == 6
    assert [text for _, text in plant.opened()] == [TEXT + n for n in (b"a", b"b", b"c")]


def test_without_keys_it_waits_and_takes_none(books: tuple[SealedBook, SealedBook]) -> None:
    controller, plant = books
    controller.queue("long", bytes(300))
    assert controller.next() is None
    assert controller.store.available() == 6
    add_keys(controller.store, plant.store, number=1)
    sealed = controller.next()
    assert sealed is not None
    assert plant.open(sealed)


def test_what_was_changed_is_refused_and_the_true_one_still_opens(
    books: tuple[SealedBook, SealedBook],
) -> None:
    controller, plant = books
    controller.queue("m", TEXT)
    sealed = controller.next()
    assert sealed is not None
    first, second = sealed.key_ids
    for forged in (
        sealed._replace(cipher=bytes([sealed.cipher[0] ^ 1]) + sealed.cipher[1:]),
        sealed._replace(tag="0" * 32),
        sealed._replace(identifier="n"),
        sealed._replace(key_ids=(second, first)),
    ):
        with pytest.raises(Unsealed):
            plant.open(forged)
    with pytest.raises(UnknownKeys):
        plant.open(sealed._replace(key_ids=(first, "no-such-key")))
    assert plant.opened() == []
    assert plant.open(sealed)


def test_an_identifier_is_one_messages_and_a_refused_store_seals_nothing(
    books: tuple[SealedBook, SealedBook],
) -> None:
    controller, _ = books
    controller.queue("m", TEXT)
    with pytest.raises(ValueError, match="'m' is another message's"):
        controller.queue("m", b"other")
    controller.store.refuse("seed 1")
    with pytest.raises(KeysRefused, match="seed 1"):
        controller.queue("n", TEXT)
    with pytest.raises(KeysRefused, match="seed 1"):
        controller.next()


def test_neither_text_nor_keys_stay_in_the_controllers_file(tmp_path: Path) -> None:
    path = tmp_path / "keys.sqlite3"
    with KeyStore(path, "controller", create=True) as store:
        add_keys(store)
        book = SealedBook(store)
        book.queue("m", TEXT)
        assert TEXT in path.read_bytes()
        sealed = book.next()
        assert sealed is not None
        assert TEXT not in path.read_bytes()
        assert not any(key in path.read_bytes() for key in (KEYS[0], KEYS[2]))
    with KeyStore(path, "controller") as store:
        assert SealedBook(store).next() == sealed


def test_a_death_within_sealing_leaves_message_and_keys(
    books: tuple[SealedBook, SealedBook], monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, _ = books
    controller.queue("m", TEXT)

    def die(*_: object) -> None:
        raise sqlite3.OperationalError("killed")

    with monkeypatch.context() as patch:
        patch.setattr("protocol.secret.sealed_book.seal", die)
        with pytest.raises(Exception, match="killed"):
            controller.next()
    assert controller.store.available() == 6
    assert controller.next() is not None
