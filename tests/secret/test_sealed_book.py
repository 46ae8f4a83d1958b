"""Sealed messages in the key store's file: one transaction each, whatever dies around it."""

import sqlite3
from pathlib import Path

import pytest

from protocol.link.peer import Notice
from protocol.secret.records import BlockRow, KeysRefused, UnknownKeys
from protocol.secret.sealed import Unsealed
from runtime.keys.asking import AUDITED, Asker
from runtime.keys.sealed_book import MOST_TRIES, SealedBook
from runtime.keys.store import KeyStore
from tests.support.giving import agree, ask, sealed_by
from tests.support.mail import mail

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
    return store.db.serialize()


def put_back(store: KeyStore, copy: bytes) -> None:
    store.db.deserialize(copy)


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


@pytest.mark.parametrize("early", [False, True])
def test_no_key_of_a_block_is_given_that_a_journal_makes_anew(
    books: tuple[SealedBook, SealedBook], early: bool
) -> None:
    """A journal that was put back has the rows of its last block: the plant knows it was made."""
    controller, plant = books
    add_keys(plant.store, number=1)
    given = [name for name, _ in plant.store.ids()][-12:]
    assert plant.store.mark("served in a life that is forgotten", given[:1]) == ()
    asker, partner = Asker(controller), Asker(plant)
    if early:  # before the plant has said so
        add_keys(controller.store, number=1)
    ask(asker, partner, 0.0)
    if not early:
        add_keys(controller.store, number=1)
    ask(asker, partner, 1.0)
    states = dict(controller.store.ids())
    found = [states.get(name) for name in given]
    assert found == (["dropped"] + ["confirmed"] * 11 if early else [None] * 12)


def test_an_end_that_was_put_back_has_not_met_the_other_before_its_newest_keys_are_asked_about(
    books: tuple[SealedBook, SealedBook],
) -> None:
    """Its keeper makes a block anew while the answers come: the other may be put back after."""
    controller, plant = books
    asker, partner = Asker(plant), Asker(controller)
    told: list[Notice] = []
    requests = asker.wake(0.0)
    for place, request in enumerate(requests):
        if place == len(requests) - 1:
            add_keys(plant.store, number=1)
        for answer in partner.receive(*mail(request)).publish:
            told += asker.receive(*mail(answer)).notices
    assert told == []
    (request,) = asker.wake(1.0)
    assert request.what == "made"
    for answer in partner.receive(*mail(request)).publish:
        told += asker.receive(*mail(answer)).notices
    assert [notice.text for notice in told] == [AUDITED]


def test_a_block_made_anew_after_the_meeting_gives_nothing_to_a_partner_that_is_put_back_then(
    books: tuple[SealedBook, SealedBook],
) -> None:
    """The plant is put back, meets, and its slow keeper makes a block of its journal once more."""
    controller, plant = books
    for _ in range(2):  # the keys of the first block are gone
        controller.queue("early", bytes(5 * 32))
        sealed = sealed_by(controller, plant.store)
    assert sealed is not None
    plant.open(sealed)
    controller.acknowledged("early")
    old_plant = copy_of(plant.store)
    add_keys(controller.store, plant.store, number=1)
    old_controller = copy_of(controller.store)
    controller.queue("a", TEXT)
    first = sealed_by(controller, plant.store)
    assert first is not None
    put_back(plant.store, old_plant)
    agree(plant.store, controller.store)
    add_keys(plant.store, number=1)
    put_back(controller.store, old_controller)
    agree(controller.store, plant.store)
    controller.queue("b", TEXT[::-1])
    second = sealed_by(controller, plant.store)
    assert second is None or not set(first.key_ids) & set(second.key_ids)


def test_a_mark_that_was_forgotten_while_its_answer_is_on_its_way_serves_no_other_message(
    books: tuple[SealedBook, SealedBook],
) -> None:
    """The plant has marked, is put back and meets the controller, which hears of the mark late."""
    controller, plant = books
    old_controller, old_plant = copy_of(controller.store), copy_of(plant.store)
    asker, partner = Asker(controller), Asker(plant)
    ask(asker, partner, 0.0)
    controller.queue("a", TEXT)
    controller.next()
    (request,) = asker.wake(1.0)
    (late,) = partner.receive(*mail(request)).publish
    put_back(plant.store, old_plant)
    anew = Asker(plant)
    for request in anew.wake(2.0):
        # what the controller asks once more is lost on the way
        *_, answer = asker.receive(*mail(request)).publish
        anew.receive(*mail(answer))
    asker.receive(*mail(late))
    first = controller.next()
    assert first is not None
    put_back(controller.store, old_controller)
    agree(controller.store, plant.store)
    controller.queue("b", TEXT[::-1])
    second = None
    for _ in range(3):
        second = second or sealed_by(controller, plant.store)
    assert second is not None
    assert not set(first.key_ids) & set(second.key_ids)


@pytest.mark.parametrize("confirmed", [True, False])
def test_what_the_other_end_has_lost_is_given_by_nobody(
    books: tuple[SealedBook, SealedBook], confirmed: bool
) -> None:
    """Three are put back in turn, each after it has met the other: to before keys were made, to
    before they were given, and again to before they were given.
    """
    controller, plant = books
    empty = copy_of(controller.store)
    add_keys(controller.store, number=1)
    row = BlockRow("s", 1, 256, 256, 512, 13, 12, "stored", 1)
    plant.store.add(row, KEYS, tag="t")
    if confirmed:
        plant.store.confirm("s", 1)
    copies = [copy_of(book.store) for book in books]
    plant.store.confirm("s", 1)
    used: list[str] = []
    for name in ("a", "b", "c", "d"):
        controller.queue(name, TEXT)
        sealed = sealed_by(controller, plant.store)
        assert sealed is not None
        used += sealed.key_ids
        plant.open(sealed)
        controller.acknowledged(name)
    put_back(controller.store, empty)
    agree(controller.store, plant.store)
    put_back(plant.store, copies[1])
    agree(plant.store, controller.store)
    put_back(controller.store, copies[0])
    agree(controller.store, plant.store)
    controller.queue("e", TEXT[::-1])
    for _ in range(4):
        if (sealed := sealed_by(controller, plant.store)) is not None:
            assert not set(sealed.key_ids) & set(used)


def test_a_mark_that_is_asked_for_comes_before_the_word_that_it_was_given(
    books: tuple[SealedBook, SealedBook],
) -> None:
    """A plant that starts while the controller waits for its mark loses no key by that."""
    controller, plant = books
    controller.queue("a", TEXT)
    assert controller.next() is None
    asker, partner = Asker(plant), Asker(controller)
    ask(asker, partner, 0.0)
    assert controller.next() is not None
    assert "dropped" not in dict(plant.store.ids()).values()


def test_a_block_that_the_other_end_is_slow_to_make_is_kept_and_given_once_it_is_confirmed(
    books: tuple[SealedBook, SealedBook],
) -> None:
    """A run ended while one end had stored its last block and the other had not."""
    controller, plant = books
    row = BlockRow("s", 1, 256, 256, 512, 13, 12, "stored", 1)
    plant.store.add(row, KEYS, tag="t")
    agree(plant.store, controller.store)
    names = [name for name, _ in plant.store.ids()][-12:]
    assert plant.store.mark("sealed m", names[:1]) == (names[0],)
    assert plant.store.given_before("unused", names) == names
    controller.store.add(row, KEYS, tag="t")
    for store in (controller.store, plant.store):
        store.confirm("s", 1)
    assert plant.store.mark("sealed m", names[:1]) == ()
    assert {state for _, state in controller.store.ids()} == {"confirmed"}
    assert {state for _, state in plant.store.ids()} == {"confirmed"}
