"""Both ends of sealed messages over a bad network, dying at will: exactly once, in order."""

import random
from collections.abc import Iterator
from math import inf
from pathlib import Path

import pytest

from protocol.link.peer import Actions, Notice
from protocol.messages import (
    KeyAnswer,
    KeyRequest,
    Message,
    SealCommand,
    Sealed,
    SealedReceipt,
    SealReply,
)
from protocol.schemes.framing import MAX_PAYLOAD
from protocol.secret.records import BlockRow
from runtime.keys.asking import AUDITED, POLL_S, REPEAT_S
from runtime.keys.sealed_book import SealedBook
from runtime.keys.sealing import OpeningEnd, SealingEnd
from runtime.keys.store import KeyStore
from tests.support.mail import mail
from tests.support.size import size

TEXTS = {f"m{i}": f"message {i}".encode() * (i + 1) for i in range(5)}


class World:
    """Two ends, their files, and a network that loses, repeats and delays."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = 0.0
        self.asked = -1.0
        self.blocks = 0
        self.stores = {
            "controller": KeyStore(folder / "c", "controller", create=True),
            "plant": KeyStore(folder / "p", "plant", create=True),
        }
        self.wire: list[tuple[float, type[Message], bytes]] = []
        self.used: list[str] = []
        self.delivered: set[str] = set()
        self.live()
        self.meet()

    def live(self) -> None:
        self.sealing = SealingEnd(SealedBook(self.stores["controller"]), self.now)
        self.opening = OpeningEnd(SealedBook(self.stores["plant"]))

    def meet(self) -> None:
        """Each end learns from the other what it gave before: nothing."""
        for end, other in ((self.sealing, self.opening), (self.opening, self.sealing)):
            for request in end.wake(-1.0).publish:
                for answer in other.receive(KeyRequest, request.wire(), -1.0).publish:
                    told = end.receive(KeyAnswer, answer.wire(), -1.0)
            assert told == Actions(notices=(Notice(AUDITED),))

    def block(self) -> None:
        keys = [self.random.randbytes(32) for _ in range(12)]
        for store in self.stores.values():
            row = BlockRow("s", self.blocks, 256, 256, 512, 13, 12, "stored", 1)
            store.add(row, keys, tag="t")
            store.confirm("s", self.blocks)
        self.blocks += 1
        if not self.now:  # in a run they ask beside all else; here they have asked
            self.asked += 0.1
            for end, other in ((self.sealing, self.opening), (self.opening, self.sealing)):
                for request in end.wake(self.asked).publish:
                    for answer in other.receive(KeyRequest, request.wire(), self.asked).publish:
                        end.receive(KeyAnswer, answer.wire(), self.asked)

    def carry_out(self, actions: Actions, *, dies: float) -> None:
        if self.random.random() < dies:  # after its transaction, before anything is said
            self.live()
            return
        for message in actions.publish:
            if isinstance(message, SealReply):
                assert message.accepted
                if message.delivered:
                    self.delivered.add(message.id)
                continue
            for _ in range(self.random.choice((0, 1, 1, 2))):
                self.wire.append((self.now + self.random.expovariate(5.0), *mail(message)))
        if self.random.random() < dies:
            self.live()

    def run(self, dies: float) -> None:
        while self.delivered != set(TEXTS):
            self.now += 0.05
            assert self.now < 600
            if self.random.random() < 0.1:
                self.block()
            if self.random.random() < 0.2:
                name = self.random.choice(list(TEXTS))
                command = SealCommand(id=name, payload=TEXTS[name]).wire()
                self.carry_out(self.sealing.receive(SealCommand, command, self.now), dies=dies)
            for end in (self.sealing, self.opening):
                if end.wake_at() <= self.now:
                    self.carry_out(end.wake(self.now), dies=dies)
            due = [m for m in self.wire if m[0] <= self.now]
            self.wire = [m for m in self.wire if m[0] > self.now]
            for _, kind, payload in due:
                if kind in (Sealed, KeyRequest, KeyAnswer):
                    self.carry_out(self.opening.receive(kind, payload, self.now), dies=dies)
                if kind in (SealedReceipt, KeyRequest, KeyAnswer):
                    self.carry_out(self.sealing.receive(kind, payload, self.now), dies=dies)

    def sealed(self, now: float = 0.0) -> Sealed:
        """What the controller sends next, once the plant was asked for its keys."""
        (request,) = self.sealing.wake(now).publish
        assert isinstance(request, KeyRequest)
        asked = request.wire()
        assert self.sealing.receive(KeyRequest, asked, now) == Actions()  # its own
        (answer,) = self.opening.receive(KeyRequest, asked, now).publish
        assert self.opening.receive(KeyAnswer, answer.wire(), now) == Actions()
        assert self.sealing.receive(KeyAnswer, answer.wire(), now) == Actions()
        (sealed,) = self.sealing.wake(now).publish
        assert isinstance(sealed, Sealed)
        return sealed


@pytest.mark.parametrize("seed", range(size(3, 6)))
def test_exactly_once_through_losses_repeats_and_deaths(seed: int, tmp_path: Path) -> None:
    world = World(tmp_path, seed)
    world.run(dies=0.0 if seed == 0 else 0.15)
    opened = SealedBook(world.stores["plant"]).opened()
    assert dict(opened) == TEXTS
    assert len(opened) == len(TEXTS)
    with world.stores["controller"].transaction() as db:
        rows = db.execute("SELECT key_ids FROM sealed ORDER BY number").fetchall()
    ids = [i for (row,) in rows for i in row.strip("[]").split(", ")]
    assert len(set(ids)) == len(ids)
    for store in world.stores.values():
        store.close()


def test_malformed_bytes_and_forgeries_change_nothing(tmp_path: Path) -> None:
    world = World(tmp_path, 1)
    world.block()
    for kind in (SealCommand, SealedReceipt):
        (notice,) = world.sealing.receive(kind, b"{", 0.0).notices
        assert "ignored" in notice.text
    assert "ignored" in world.opening.receive(Sealed, b"[]", 0.0).notices[0].text
    ids = [name for name, _ in world.stores["plant"].ids()][:3:2]
    forged = Sealed(id="m", key_ids=tuple(ids), cipher=b"x" * 22, tag="0" * 32)
    (notice,) = world.opening.receive(Sealed, forged.wire(), 0.0).notices
    assert "2 of the keys asked for are not in this store" in notice.text  # nobody set them aside
    receipt = SealedReceipt(id="m").wire()
    assert world.sealing.receive(SealedReceipt, receipt, 0.0) == Actions()
    long = SealCommand(id="m", payload=bytes(70_000)).wire()
    (out,) = world.sealing.receive(SealCommand, long, 0.0).publish
    assert isinstance(out, SealReply)
    assert "got 70000 bytes" in out.detail


def test_it_is_repeated_until_it_is_acknowledged_and_no_longer(tmp_path: Path) -> None:
    world = World(tmp_path, 1)
    world.block()
    world.sealing.receive(SealCommand, SealCommand(id="m", payload=b"text").wire(), 0.0)
    first = world.sealed()
    assert world.sealing.wake(REPEAT_S / 2) == Actions()
    assert world.sealing.wake(REPEAT_S).publish == (first,)
    receipt = world.opening.receive(Sealed, first.wire(), 0.0).publish[0]
    world.sealing.receive(SealedReceipt, receipt.wire(), 0.3)
    assert world.sealing.due_at == inf
    for store in world.stores.values():
        store.close()


# --- what each end says, word for word ------------------------------------------------------------


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    made = World(tmp_path, 1)
    yield made
    for store in made.stores.values():
        store.close()


def commanded(world: World, name: str, text: bytes, now: float = 0.0) -> SealReply:
    """What the operator hears; nothing else is said or logged."""
    actions = world.sealing.receive(SealCommand, SealCommand(id=name, payload=text).wire(), now)
    (out,) = actions.publish
    assert actions == Actions(publish=(out,))
    assert isinstance(out, SealReply)
    return out


def reply(name: str, detail: str, *, accepted: bool = True, delivered: bool = False) -> SealReply:
    return SealReply(id=name, accepted=accepted, delivered=delivered, detail=detail)


def test_a_message_is_answered_by_where_it_stands(world: World) -> None:
    assert commanded(world, "m", b"text") == reply("m", "queued: takes 2 keys, 0 there")
    world.block()
    assert commanded(world, "m", b"text") == reply("m", "queued: takes 2 keys, 6 there")
    world.sealed()
    assert commanded(world, "m", b"text") == reply("m", "sealed: takes 2 keys")
    receipt = SealedReceipt(id="m").wire()
    actions = world.sealing.receive(SealedReceipt, receipt, 1.0)
    assert actions == Actions(notices=(Notice("sealed message m delivered"),))
    assert world.sealing.receive(SealedReceipt, receipt, 1.0) == Actions()
    assert commanded(world, "m", b"text") == reply("m", "done: takes 2 keys", delivered=True)


@pytest.mark.parametrize("size", [0, MAX_PAYLOAD + 1])
def test_a_message_of_another_size_is_not_taken(world: World, size: int) -> None:
    why = f"message: got {size} bytes, expected 1 to {MAX_PAYLOAD}"
    assert commanded(world, "m", bytes(size)) == reply("m", why, accepted=False)
    assert world.sealing.due_at == inf


@pytest.mark.parametrize("size", [1, MAX_PAYLOAD])
def test_the_smallest_and_the_largest_message_are_taken(world: World, size: int) -> None:
    assert commanded(world, "m", bytes(size)).accepted


def test_one_identifier_is_one_message(world: World) -> None:
    commanded(world, "m", b"text")
    why = "id: 'm' is another message's"
    assert commanded(world, "m", b"other") == reply("m", why, accepted=False)


def test_keys_that_are_for_nobody_seal_nothing(world: World) -> None:
    commanded(world, "m", b"text")
    world.stores["controller"].refuse("seeded")
    assert commanded(world, "n", b"text") == reply("n", "seeded", accepted=False)
    told = Notice("nothing can be sealed: seeded", "error", "keys")
    assert world.sealing.wake(0.0) == Actions(notices=(told,))


@pytest.mark.parametrize(
    ("kind", "wrong", "text"),
    [
        (SealCommand, b"[]", "sealing: 1 fields not as expected; ignored"),
        (SealCommand, b"{}", "sealing: 2 fields not as expected; ignored"),
        (SealedReceipt, b"[]", "sealing: 1 fields not as expected; ignored"),
        (Sealed, b"[]", "sealed: 1 fields not as expected; ignored"),
        (Sealed, b"{}", "sealed: 4 fields not as expected; ignored"),
    ],
)
def test_what_is_malformed_is_counted_by_fields(
    world: World, kind: type[Message], wrong: bytes, text: str
) -> None:
    end = world.opening if kind is Sealed else world.sealing
    told = Notice(text, "warning", "malformed")
    assert end.receive(kind, wrong, 0.0) == Actions(notices=(told,))


def test_the_plant_opens_once_and_acknowledges_each_time(world: World) -> None:
    world.block()
    commanded(world, "m", b"text")
    sealed = world.sealed().wire()
    receipt = SealedReceipt(id="m")
    first = world.opening.receive(Sealed, sealed, 0.0)
    told = Notice("sealed message m opened: 4 bytes")
    assert first == Actions(publish=(receipt,), notices=(told,))
    assert world.opening.receive(Sealed, sealed, 0.0) == Actions(publish=(receipt,))
    assert world.opening.wake(0.0) == Actions()
    assert world.opening.wake_at() == POLL_S


def test_what_cannot_be_opened_is_refused_and_given_up_and_the_next_one_goes_out(
    world: World,
) -> None:
    """The plant's store is put back: it knows of no message under these keys."""
    world.block()
    copy = world.stores["plant"].db.serialize()
    for name in ("m", "n"):
        commanded(world, name, b"text")
    sealed = world.sealed()
    world.stores["plant"].db.deserialize(copy)
    why = "2 of the keys asked for are not in this store"
    told = Notice(f"not opened: {why}", "warning", "sealed")
    refusal = SealedReceipt(id="m", key_ids=sealed.key_ids, refused=why)
    assert world.opening.receive(Sealed, sealed.wire(), 0.1) == Actions(
        publish=(refusal,), notices=(told,)
    )
    other = SealedReceipt(id="m", key_ids=("a", "b"), refused=why).wire()  # a forger's message's
    assert world.sealing.receive(SealedReceipt, other, 0.2) == Actions()
    text = f"sealed message m given up: the plant cannot open it: {why}"
    assert world.sealing.receive(SealedReceipt, refusal.wire(), 0.2) == Actions(
        notices=(Notice(text, "error"),)
    )
    assert world.sealing.receive(SealedReceipt, refusal.wire(), 0.2) == Actions()
    why = "id: 'm' was given up: the plant had lost its keys; send the message again, under "
    assert commanded(world, "m", b"text") == reply("m", f"{why}another id", accepted=False)
    assert world.sealing.due_at == 0.2
    following = world.sealed(0.3)
    assert following.id == "n"
    assert not set(following.key_ids) & set(sealed.key_ids)


# --- when -----------------------------------------------------------------------------------------


def test_nothing_is_due_before_there_is_a_message(world: World) -> None:
    assert world.sealing.due_at == inf
    commanded(world, "m", b"text", 3.0)
    assert world.sealing.due_at == 3.0
    assert world.sealing.wake(2.9) == Actions()
    assert world.sealing.wake(3.0) == Actions()  # there are no keys yet
    assert world.sealing.due_at == 3.0 + REPEAT_S
    commanded(world, "n", b"text", 3.1)
    assert world.sealing.due_at == 3.1
    commanded(world, "n", b"text", 3.2)
    assert world.sealing.due_at == 3.1


def test_the_next_message_goes_out_when_the_one_before_has_arrived(world: World) -> None:
    world.block()
    for name in ("m", "n"):
        commanded(world, name, b"text")
    world.sealed()
    world.sealing.receive(SealedReceipt, SealedReceipt(id="m").wire(), 0.1)
    assert world.sealing.due_at == 0.1
    assert world.sealed(0.1).id == "n"


def test_who_comes_back_goes_on_at_once(world: World) -> None:
    commanded(world, "m", b"text")
    assert SealingEnd(SealedBook(world.stores["controller"]), 7.0).due_at == 7.0
