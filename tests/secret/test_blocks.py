"""Blocks: where they begin, what is in them, and how two ends come to hold the same keys.

Two keepers with stores of their own exchange words over a network that loses, repeats and delays,
and die at any instant. What is confirmed must be equal, and nobody may wait for ever.
"""

import os
import random
from collections.abc import Sequence
from pathlib import Path

import pytest
from runtime.keys.key_maker import KeyMaker
from runtime.keys.store import KeyStore

from protocol.secret.blocks import (
    NO_TAG,
    BlockResult,
    Blocks,
    ClosedBlock,
    OpenBlock,
    Schedule,
    Stored,
    schedule_of,
)
from protocol.secret.bound import Assumption
from protocol.secret.nonces import Contribution, contribution_of
from runtime.chance import fresh_nonce
from tests.support.giving import deliver, deliver_named

SESSION = "0123456789abcdef"
SMALL = Schedule(Assumption(0.9, eps_sec=1e-2), first=3, largest=6)


def test_the_schedule_follows_from_the_claim() -> None:
    expected = {0.01: (1548, 8192), 0.05: (304, 2048), 0.1: (148, 1024), 0.3: (44, 256)}
    for eps_E, (first, largest) in expected.items():
        schedule = schedule_of(Assumption(eps_E))
        assert schedule is not None
        assert (schedule.first, schedule.largest) == (first, largest)
    assert schedule_of(Assumption(0.0)) is None
    assert schedule_of(Assumption(0.00001)) is None


def test_blocks_grow_and_follow_each_other_without_a_gap() -> None:
    schedule = schedule_of(Assumption(0.3))
    assert schedule is not None
    assert [schedule.length(b) for b in range(5)] == [44, 88, 176, 256, 256]
    assert [schedule.begins(b) for b in range(5)] == [1, 45, 133, 309, 565]
    assert schedule.begins(1000) == 309 + 997 * 256
    numbers = [schedule.block_of(j) for j in range(2000)]
    assert numbers[0] == -1
    for b in range(6):
        assert numbers.count(b) == schedule.length(b)
        assert numbers[schedule.begins(b)] == b
    for first, largest in ((1, 1), (3, 64), (64, 64), (5, 1024), (64, 128)):
        blocks = Schedule(schedule.assumption, first, largest)
        lengths = [min(largest, first << b) for b in range(14)]
        assert [blocks.length(b) for b in range(14)] == lengths
        places = [b for b, n in enumerate(lengths) for _ in range(n)]
        assert [blocks.block_of(j) for j in range(len(places) + 1)] == [-1, *places]
        assert [blocks.begins(b) for b in range(14)] == [1 + places.index(b) for b in range(14)]
    # what each makes where nothing is lost
    rows = [schedule.assumption.rows(n, n, 2 * n) for n in (44, 88, 176, 256)]
    assert [r - 1 for r in rows] == [1, 14, 48, 84]


def closed(contributions: Sequence[Contribution], session: str = SESSION) -> ClosedBlock:
    block = OpenBlock(SMALL.assumption)
    for contribution in contributions:
        block.add(contribution)
    return block.close(session, 0, contributions[-1].j)


def test_a_block_is_everything_counted_in_order() -> None:
    nonce = [bytes([i]) * 32 for i in range(6)]
    contributions = (
        Contribution(1, 1, nonce[0], nonce[1]),
        Contribution(2, 3, None, nonce[2]),
        Contribution(3, 1, nonce[3], None),
        Contribution(4, 2, None, None),
    )
    block = closed(contributions)
    assert block.nonces == tuple(nonce[:4])
    assert (block.transitions, block.steps, block.counted, block.last) == (4, 7, 4, 4)
    assert block.rows == 0  # ten copies of fourteen were lost


def test_what_does_not_count_leaves_no_nonce() -> None:
    offer, measurement = fresh_nonce(), fresh_nonce()
    assert len(offer) == 44
    kept = contribution_of(
        j=1, steps=1, offer=offer, applied_copy=1, measurement=measurement, heard=0
    )
    assert kept.offer is None
    assert kept.measurement is not None
    assert len(kept.measurement) == 32


def counting(last: int) -> Blocks:
    """A session's blocks once so many transitions have been counted."""
    blocks = Blocks(SMALL, SESSION)
    for j in range(1, last + 1):
        blocks.count(Contribution(j, 1, None, None))
    return blocks


def test_a_block_is_announced_once_a_later_transition_was_counted() -> None:
    """Until then the plant could be put back, and count its last transition otherwise."""
    blocks = counting(3)
    blocks.stored(Stored(SESSION, 0, "a"))
    assert blocks.announcement() == (-1, NO_TAG)
    blocks.count(Contribution(4, 1, None, None))
    assert blocks.announcement() == (0, "a")


def test_a_later_block_that_holds_confirms_the_one_before() -> None:
    blocks = counting(16)
    assert blocks.announcement() == (-1, NO_TAG)
    blocks.stored(Stored(SESSION, 0, "a"))
    blocks.stored(Stored(SESSION, 2, "c"))  # block 1 made no key
    assert blocks.announcement() == (0, "a")
    assert blocks.announcement() == (0, "a")  # not before block 0 is confirmed
    assert blocks.heard(2, "c") == (
        BlockResult(SESSION, 0, "confirmed"),
        BlockResult(SESSION, 2, "confirmed"),
    )
    assert blocks.heard(0, "never looked at") == ()
    assert blocks.announcement() == (2, "c")


def test_a_tag_that_differs_is_told_once() -> None:
    blocks = Blocks(SMALL, SESSION)
    blocks.stored(Stored(SESSION, 0, "a"))
    assert blocks.heard(0, "y") == (BlockResult(SESSION, 0, "unequal"),)
    assert blocks.heard(0, "y") == ()
    assert blocks.heard(0, "a") == ()


def test_another_sessions_blocks_are_of_no_concern() -> None:
    blocks = Blocks(SMALL, SESSION)
    blocks.stored(Stored("f" * 16, 0, "a"))
    assert blocks.announcement() == (-1, NO_TAG)


def test_rows_are_kept_until_a_block_is_confirmed_and_announced() -> None:
    blocks = counting(10)
    blocks.stored(Stored(SESSION, 0, "a"))
    blocks.heard(0, "a")
    blocks.judged(SESSION, 0)
    assert blocks.obsolete_rows() == ()  # the partner has not been told
    blocks.announcement()
    assert blocks.obsolete_rows() == (range(1, 4),)
    assert blocks.obsolete_rows() == ()
    blocks.stored(Stored(SESSION, 1, ""))
    assert blocks.obsolete_rows() == (range(4, 10),)


class End:
    """One end with its store and what a journal would keep: the word, and the rows."""

    def __init__(self, folder: Path, side: str, contributions: list[Contribution]) -> None:
        self.path, self.side, self.contributions = folder / f"{side}.db", side, contributions
        self.rows: dict[int, Contribution] = {}
        self.word = (-1, NO_TAG)
        self.j = 0
        self.alarms = 0
        self.start()

    def start(self) -> None:
        self.store = KeyStore(self.path, self.side, create=True)  # type: ignore[arg-type]
        self.store.db.execute("PRAGMA synchronous=OFF")  # the process dies here, not the machine
        self.key_maker = KeyMaker(self.store)
        self.verdicts: list[BlockResult] = []
        self.blocks = Blocks(SMALL, SESSION, *self.word, contributions=self.rows.values())

    def die(self) -> None:
        self.store.close()
        self.start()

    def count(self) -> None:
        if self.j == len(self.contributions):
            return
        contribution = self.contributions[self.j]
        self.j += 1
        if contribution.j:
            self.rows[contribution.j] = contribution
            self.blocks.count(contribution)

    def work(self) -> None:
        if (block := self.blocks.to_keep()) is not None:
            self.verdicts += self.blocks.stored(self.key_maker.make_keys(block))
        elif self.verdicts:
            verdict = self.verdicts.pop(0)
            self.key_maker.judge(verdict)
            self.blocks.judged(SESSION, verdict.number)

    def speak(self) -> tuple[int, str]:
        self.word = self.blocks.announcement()  # journalled before it is said
        for over in self.blocks.obsolete_rows():
            for j in over:
                del self.rows[j]
        return self.word

    def hear(self, word: tuple[int, str]) -> None:
        for verdict in self.blocks.heard(*word):
            self.alarms += verdict.what == "unequal"
            self.verdicts.append(verdict)


def rows_of(generator: random.Random, count: int) -> list[Contribution]:
    return [
        Contribution(
            j,
            1 + (generator.random() < 0.02),
            generator.randbytes(32) if generator.random() < 0.98 else None,
            generator.randbytes(32) if generator.random() < 0.98 else None,
        )
        for j in range(count)
    ]


@pytest.mark.parametrize("seed", range(3))
def test_two_ends_hold_the_same_keys_whatever_dies(tmp_path: Path, seed: int) -> None:
    generator = random.Random(seed)
    contributions = rows_of(generator, 120)
    ends = [End(tmp_path, side, contributions) for side in ("controller", "plant")]
    words: list[tuple[End, tuple[int, str]]] = []
    deaths = 0
    for step in range(1500):
        end, other = generator.sample(ends, 2)
        action = generator.random()
        if action < 0.2:
            end.count()
        elif action < 0.5:
            end.work()
        elif action < 0.7:
            words.append((other, end.speak()))
        elif words:
            to, word = generator.choice(words[-6:])
            to.hear(word)
        if generator.random() < 0.03 and step < 1400:
            end.die()
            deaths += 1
    for _ in range(200):  # and then all is well
        for end, other in (ends, ends[::-1]):
            end.count()
            end.work()
            other.hear(end.speak())
    assert deaths > 20
    assert [end.alarms for end in ends] == [0, 0]
    controller, plant = (end.store for end in ends)
    assert controller.ids() == plant.ids()
    assert {state for _, state in controller.ids()} == {"confirmed"}
    assert len(controller.ids()) > 80
    assert max(len(end.rows) for end in ends) <= SMALL.largest + 6
    for giver, taker in ((controller, plant), (plant, controller)):
        given = deliver(giver, giver.available(), partner=taker)
        assert deliver_named(taker, [key.key_id for key in given], partner=giver) == given
    for store in (controller, plant):
        store.close()


def test_other_raw_nonces_are_an_alarm_and_no_key(tmp_path: Path) -> None:
    contributions = rows_of(random.Random(1), 10)
    forged = [
        *contributions[:2],
        contributions[2]._replace(offer=os.urandom(32)),
        *contributions[3:],
    ]
    ends = [End(tmp_path, "controller", contributions), End(tmp_path, "plant", forged)]
    for _ in range(30):
        for end, other in (ends, ends[::-1]):
            end.count()
            end.work()
            other.hear(end.speak())
    assert [end.alarms for end in ends] == [1, 1]
    for end in ends:
        assert end.store.available() == 0
        assert {state for name, state in end.store.ids() if state != "stored"} == {"dropped"}
        end.store.close()
