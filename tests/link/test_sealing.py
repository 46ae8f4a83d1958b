"""Both ends of sealed messages over a bad network, dying at will: exactly once, in order."""

import random
from pathlib import Path

import pytest

from protocol.link.endpoint import Actions
from protocol.link.sealing import REPEAT_S, OpeningEnd, SealingEnd
from protocol.messages import Message, SealCommand, Sealed, SealedReceipt, SealReply
from protocol.secret.records import BlockRow
from protocol.secret.sealed_book import SealedBook
from protocol.secret.store import KeyStore

TEXTS = {f"m{i}": f"message {i}".encode() * (i + 1) for i in range(5)}


class World:
    """Two ends, their files, and a network that loses, repeats and delays."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = 0.0
        self.blocks = 0
        self.stores = {
            "controller": KeyStore(folder / "c", "controller", create=True),
            "plant": KeyStore(folder / "p", "plant", create=True),
        }
        self.wire: list[tuple[float, type[Message], bytes]] = []
        self.used: list[str] = []
        self.delivered: set[str] = set()
        self.live()

    def live(self) -> None:
        self.sealing = SealingEnd(SealedBook(self.stores["controller"]), self.now)
        self.opening = OpeningEnd(SealedBook(self.stores["plant"]))

    def block(self) -> None:
        keys = [self.random.randbytes(32) for _ in range(12)]
        for store in self.stores.values():
            row = BlockRow("s", self.blocks, 256, 256, 512, 13, 12, "stored", 1)
            store.add(row, keys, tag="t")
            store.confirm("s", self.blocks)
        self.blocks += 1

    def carry_out(self, actions: Actions, *, dies: float) -> None:
        if self.random.random() < dies:  # after its transaction, before anything is said
            self.live()
            return
        for kind, payload in actions.publish:
            if kind is SealReply:
                reply = SealReply.model_validate_json(payload)
                assert reply.accepted
                if reply.delivered:
                    self.delivered.add(reply.id)
                continue
            for _ in range(self.random.choice((0, 1, 1, 2))):
                self.wire.append((self.now + self.random.expovariate(5.0), kind, payload))
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
            if self.sealing.wake_at() <= self.now:
                self.carry_out(self.sealing.wake(self.now), dies=dies)
            due = [m for m in self.wire if m[0] <= self.now]
            self.wire = [m for m in self.wire if m[0] > self.now]
            for _, kind, payload in due:
                if kind is Sealed:
                    self.carry_out(self.opening.receive(kind, payload, self.now), dies=dies)
                else:
                    assert kind is SealedReceipt
                    self.carry_out(self.sealing.receive(kind, payload, self.now), dies=dies)


@pytest.mark.parametrize("seed", range(6))
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


def test_garbage_and_forgeries_change_nothing(tmp_path: Path) -> None:
    world = World(tmp_path, 1)
    world.block()
    for kind in (SealCommand, SealedReceipt):
        (notice,) = world.sealing.receive(kind, b"{", 0.0).notices
        assert "ignored" in notice.text
    assert "ignored" in world.opening.receive(Sealed, b"[]", 0.0).notices[0].text
    ids = [name for name, _ in world.stores["plant"].ids()][:3:2]
    forged = Sealed(id="m", key_ids=tuple(ids), cipher=b"x" * 22, tag="0" * 32)
    (notice,) = world.opening.receive(Sealed, forged.wire(), 0.0).notices
    assert "its tag does not hold" in notice.text
    receipt = SealedReceipt(id="m").wire()
    assert world.sealing.receive(SealedReceipt, receipt, 0.0) == Actions()
    long = SealCommand(id="m", payload=bytes(70_000)).wire()
    (out,) = world.sealing.receive(SealCommand, long, 0.0).publish
    assert "got 70000 bytes" in SealReply.model_validate_json(out.payload).detail


def test_it_is_repeated_until_it_is_acknowledged_and_no_longer(tmp_path: Path) -> None:
    world = World(tmp_path, 1)
    world.block()
    world.sealing.receive(SealCommand, SealCommand(id="m", payload=b"text").wire(), 0.0)
    first = world.sealing.wake(0.0).publish
    assert world.sealing.wake(REPEAT_S / 2) == Actions()
    assert world.sealing.wake(REPEAT_S).publish == first
    receipt = world.opening.receive(Sealed, first[0].payload, 0.0).publish[0]
    world.sealing.receive(SealedReceipt, receipt.payload, 0.3)
    assert world.sealing.wake_at() == float("inf")
    for store in world.stores.values():
        store.close()
