"""Sealed messages in the key store's file: one transaction each, whatever dies around it."""

import sqlite3
from pathlib import Path

import pytest

from protocol.messages import KeyAnswer, KeyRequest
from protocol.secret.records import BlockRow, KeysRefused, UnknownKeys
from protocol.secret.sealed import Unsealed
from runtime.keys.asking import Asker
from runtime.keys.sealed_book import MOST_TRIES, SealedBook
from runtime.keys.store import KeyStore
from tests.support.giving import agree, sealed_by

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
    assert controller.next() is None  # the plant has not marked its keys
    assert controller.queue("m", TEXT) == "asked"
    sealed = sealed_by(controller, plant.store)
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
        sealed = sealed_by(controller, plant.store)
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
    sealed = sealed_by(controller, plant.store)
    assert sealed is not None
    assert plant.open(sealed)


def test_what_was_changed_is_refused_and_the_true_one_still_opens(
    books: tuple[SealedBook, SealedBook],
) -> None:
    controller, plant = books
    controller.queue("m", TEXT)
    sealed = sealed_by(controller, plant.store)
    assert sealed is not None
    first, second = sealed.key_ids
    for forged in (
        sealed._replace(cipher=bytes([sealed.cipher[0] ^ 1]) + sealed.cipher[1:]),
        sealed._replace(tag="0" * 32),
        sealed._replace(key_ids=(second, first)),
    ):
        with pytest.raises(Unsealed):
            plant.open(forged)
    for forged in (
        sealed._replace(identifier="n"),  # its keys are not that one's
        sealed._replace(key_ids=(first, "no-such-key")),
    ):
        with pytest.raises(UnknownKeys):
            plant.open(forged)
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
        with KeyStore(None, "plant") as plant:
            add_keys(plant)
            sealed = sealed_by(book, plant)
        assert sealed is not None
        assert TEXT not in path.read_bytes()
        assert not any(key in path.read_bytes() for key in (KEYS[0], KEYS[2]))
    with KeyStore(path, "controller") as store:
        assert SealedBook(store).next() == sealed


def test_a_death_within_sealing_leaves_message_and_keys(
    books: tuple[SealedBook, SealedBook], monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, plant = books
    controller.queue("m", TEXT)

    def die(*_: object) -> None:
        raise sqlite3.OperationalError("killed")

    with monkeypatch.context() as patch:
        patch.setattr("runtime.keys.sealed_book.seal", die)
        with pytest.raises(Exception, match="killed"):
            sealed_by(controller, plant.store)
    assert sealed_by(controller, plant.store) is not None
    assert controller.store.available() == 4


# --- a store that is put back ---------------------------------------------------------------------


def copy_of(store: KeyStore) -> bytes:
    return store._db.serialize()


def put_back(store: KeyStore, copy: bytes) -> None:
    store._db.deserialize(copy)


@pytest.mark.parametrize("when", ["before", "queued", "asked"])
def test_a_controller_that_is_put_back_seals_under_other_keys(
    books: tuple[SealedBook, SealedBook], when: str
) -> None:
    """Its first life sent A; the second one's B must be under other keys, or be A once more."""
    controller, plant = books
    copy = copy_of(controller.store)
    controller.queue("a", TEXT)
    if when == "queued":
        copy = copy_of(controller.store)
    assert controller.next() is None
    if when == "asked":
        copy = copy_of(controller.store)
    first = sealed_by(controller, plant.store)
    assert first is not None
    plant.open(first)
    put_back(controller.store, copy)
    if when == "before":
        controller.queue("b", b"another text, as long.")
    second = None
    for _ in range(3):
        second = second or sealed_by(controller, plant.store)
    assert second is not None
    if when == "asked":
        assert second == first
    else:
        assert not set(first.key_ids) & set(second.key_ids)
        assert dict(controller.store.ids())[first.key_ids[0]] == "dropped"
        assert plant.open(second) == (when == "before")


def test_a_plant_that_is_put_back_refuses_and_the_next_message_arrives(
    books: tuple[SealedBook, SealedBook],
) -> None:
    controller, plant = books
    copy = copy_of(plant.store)
    controller.queue("a", TEXT)
    controller.queue("b", TEXT)
    first = sealed_by(controller, plant.store)
    assert first is not None
    put_back(plant.store, copy)
    with pytest.raises(UnknownKeys):
        plant.open(first)  # it has them, but knows of no message under them
    assert not controller.give_up("a", first.key_ids[:1])
    assert controller.give_up("a", first.key_ids)
    assert not controller.give_up("a", first.key_ids)
    assert controller.queue("a", TEXT) == "lost"
    second = sealed_by(controller, plant.store)
    assert second is not None
    assert not set(first.key_ids) & set(second.key_ids)
    assert plant.open(second)


def test_a_forger_has_so_many_tries_and_no_more(books: tuple[SealedBook, SealedBook]) -> None:
    controller, plant = books
    controller.queue("m", TEXT)
    sealed = sealed_by(controller, plant.store)
    assert sealed is not None
    for number in range(MOST_TRIES):
        told = "16 times: its keys are given up" if number == MOST_TRIES - 1 else "does not hold"
        with pytest.raises(Unsealed, match=told):
            plant.open(sealed._replace(tag=f"{number:032x}"))
    with pytest.raises(UnknownKeys):
        plant.open(sealed)
    assert controller.give_up("m", sealed.key_ids)


def test_both_put_back_at_different_times_give_nothing_twice_once_they_have_met(
    books: tuple[SealedBook, SealedBook],
) -> None:
    """The first that is put back learns at its start what it gave, before the second forgets it."""
    controller, plant = books
    copies = [copy_of(book.store) for book in books]
    used: list[str] = []
    for name in ("a", "b"):
        controller.queue(name, TEXT)
        sealed = sealed_by(controller, plant.store)
        assert sealed is not None
        used += sealed.key_ids
        plant.open(sealed)
        controller.acknowledged(name)
    for book, copy in zip(books, copies, strict=True):
        put_back(book.store, copy)
        agree(controller.store, plant.store)  # both run
    controller.queue("c", TEXT)
    sealed = sealed_by(controller, plant.store)
    assert sealed is not None
    assert not set(sealed.key_ids) & set(used)


def test_both_put_back_together_is_what_nobody_can_tell(
    books: tuple[SealedBook, SealedBook],
) -> None:
    controller, plant = books
    copies = [copy_of(book.store) for book in books]
    controller.queue("a", TEXT)
    first = sealed_by(controller, plant.store)
    for book, copy in zip(books, copies, strict=True):
        put_back(book.store, copy)
    controller.queue("b", b"another text, as long.")
    second = sealed_by(controller, plant.store)
    assert first is not None
    assert second is not None
    assert first.key_ids == second.key_ids  # which the page and `wyner status` say


def test_keys_that_are_made_anew_are_asked_about_too(books: tuple[SealedBook, SealedBook]) -> None:
    """A journal that was put back makes the keys of its last block once more."""
    controller, plant = books
    add_keys(plant.store, number=1)
    given = [name for name, _ in plant.store.ids()][-12:]
    assert plant.store.mark("served in a life that is forgotten", given[:1]) == ()
    asker, partner = Asker(controller), Asker(plant)

    def meet(now: float) -> None:
        for _, request in asker.wake(now):
            for _, answer in partner.receive(KeyRequest, request).publish:
                asker.receive(KeyAnswer, answer)

    meet(0.0)
    add_keys(controller.store, number=1)
    meet(1.0)
    states = dict(controller.store.ids())
    assert [states[name] for name in given] == ["dropped"] + ["confirmed"] * 11
