"""The one who goes for the keys, on messages of the two real ends: what she holds is what is."""

import logging
import random
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import cast

import pytest

from protocol.knowledge import Knowledge
from protocol.link.records import Side
from protocol.messages import FieldMessage, Measurement, Message, Offer
from protocol.messages.adversary import KeysHeld
from protocol.secret.blocks import ClosedBlock, ExtractedBlock, schedule_of
from protocol.secret.bound import Assumption
from protocol.secret.extractor import extracted
from protocol.secret.key_digits import digits
from protocol.secret.stream import Position
from tap_service.eavesdroppers import KnowledgeError, named
from tap_service.eavesdroppers.key_solver import KeySolver
from tap_service.listening import Listener, Listeners
from tests.support.held_memory import kept
from tests.support.line import keyed_rules
from tests.support.mail import Mail
from tests.support.pair import LinePair, Name
from tests.support.size import size
from wyner.runs.score.words import held_line

CLAIM = Assumption(0.5)
KNOWLEDGE = Knowledge(scenario="line", period_s=0.1, candidates=2, keys=CLAIM)


class Recorded(LinePair):
    """A world whose field messages are kept; some of them never arrive."""

    def __init__(self, claim: Assumption, lose: Callable[[Message], bool]) -> None:
        self.field: list[FieldMessage] = []
        self._lose = lose
        self.closed: list[ClosedBlock] = []
        super().__init__(keyed_rules(schedule=schedule_of(claim)), period_s=0.3)

    def said(self, side: Name, message: Mail) -> None:
        if message.kind in (Measurement, Offer):
            said = message.kind.model_validate_json(message.payload)
            assert isinstance(said, Measurement | Offer)
            self.field.append(said)
            if self._lose(said):
                return
        super().said(side, message)

    def extract(self, side: Side) -> None:
        if side == "controller" and self.ends[side].closed:
            self.closed.append(self.ends[side].closed[0])
        super().extract(side)


@cache
def recorded(
    lossy: bool = False, claim: Assumption = CLAIM
) -> tuple[list[FieldMessage], list[ClosedBlock], list[ExtractedBlock]]:
    """Messages of some blocks, the controller's blocks, and their keys."""
    draw = random.Random(4)
    world = Recorded(claim, lambda _: lossy and draw.random() < 0.01)
    while sum(world.onlooker.blocks.values()) < 4:
        world.next()
    for _ in range(60):  # so that who missed the last words hears later ones
        world.next()
    confirmed = world.onlooker.blocks
    blocks = [b for b in world.closed if (b.session, b.number) in confirmed]
    world.close()
    return world.field, blocks, [extracted(block) for block in blocks]


def keys_of(solver: KeySolver, made: list[ExtractedBlock]) -> list[tuple[bytes, ...]]:
    """What she computes of the keys of these blocks; nothing of a block that she has not."""
    return [solver.keys_of(block.session, block.number) for block in made]


def fed(messages: Iterable[FieldMessage], knowledge: Knowledge = KNOWLEDGE) -> Listener:
    """Feed her as the tap does."""
    listeners = Listeners({"key-solver": knowledge}, lambda _line: None, logging.getLogger("test"))
    for message in messages:
        listeners.hear(message)
    listeners.finish()
    (listener,) = listeners.listeners
    assert not listener.failed
    return listener


def solver_of(messages: Iterable[FieldMessage], knowledge: Knowledge = KNOWLEDGE) -> KeySolver:
    """One who heard these, to be asked for keys."""
    return cast("KeySolver", fed(messages, knowledge).tap)


def held_by(messages: Iterable[FieldMessage], knowledge: Knowledge = KNOWLEDGE) -> KeysHeld:
    """What she says that she holds."""
    keys = fed(messages, knowledge).belief().keys
    assert keys is not None
    return keys


def without(messages: Iterable[FieldMessage], loss: float, seed: int) -> Iterator[FieldMessage]:
    draw = random.Random(seed)
    for message in messages:
        if draw.random() >= loss:
            yield message


@pytest.mark.parametrize("at", [0, 1, 90, 91])
def test_stray_messages_cost_her_no_key(at: int) -> None:
    """One of another session, and she held 0 bits of 0 blocks where she had held 103,936 bits."""
    messages, _, _ = recorded()
    whole = held_by(messages)
    strays = [
        messages[20 + i].model_copy(update={"session": f"{i + 10:016x}", "k": 10**i})
        for i in range(6)
    ]
    assert held_by([*messages[:at], *strays, *messages[at:]]) == whole


def test_transitions_that_fall_in_no_block_are_told() -> None:
    """ "0 of 0 key blocks" read as if no key had been made."""
    messages, _, made = recorded()
    keys = held_by(messages[60:])
    assert (keys.blocks, keys.bits) == (0, 0)
    assert keys_of(solver_of(messages[60:]), made) == [()] * len(made)
    assert keys.unplaced > len(messages) / 2 - 40
    assert f"{keys.unplaced} transitions fell in no block" in held_line(keys)
    assert held_by(messages).unplaced == 0
    assert "transitions" not in held_line(held_by(messages))


@pytest.mark.parametrize(
    ("lossy", "claim"),
    [(False, CLAIM), (True, CLAIM), (False, Assumption(0.5, unheard_bits=128))],
)
def test_who_hears_all_holds_every_row_and_every_key(lossy: bool, claim: Assumption) -> None:
    messages, blocks, made = recorded(lossy, claim)
    knowledge = KNOWLEDGE.model_copy(update={"keys": claim})
    keys = held_by(messages, knowledge)
    assert [(b.number, b.counted, b.rows, b.missed) for b in keys.newest] == [
        (b.number, b.counted, b.rows, 0) for b in blocks if b.rows >= 2
    ]
    assert keys.bits == 256 * sum(b.rows for b in blocks if b.rows >= 2) > 0
    assert keys.broken == keys.blocks
    assert keys.refuted
    hers = solver_of(messages, knowledge)
    assert keys_of(hers, made) == [block.keys for block in made]
    for block in made:
        stream = [digit for key in block.keys for digit in digits(key, hers.size)]
        count = len(stream)
        for at in range(0, count, 7):
            found = hers.digits(block.session, Position(block.number, at), 1)
            assert found == tuple(stream[at : at + 1])


@pytest.mark.parametrize("seed", range(3))
def test_who_misses_as_much_as_is_claimed_holds_nothing(seed: int) -> None:
    messages, blocks, made = recorded()
    keys = held_by(without(messages, 0.5, seed))
    assert keys.blocks == len(blocks)
    assert (keys.bits, keys.broken, keys.refuted, keys.bursts) == (0, 0, False, False)
    assert 0.4 < keys.missed / keys.copies < 0.6
    hers = solver_of(without(messages, 0.5, seed))
    assert keys_of(hers, made) == [()] * len(made)


@pytest.mark.long
@pytest.mark.parametrize("loss", [0.0, 0.6])
def test_she_keeps_no_more_of_many_blocks_than_of_a_few(
    loss: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tap_service.eavesdroppers.key_solver.KEPT_BLOCKS", 4)
    claim = Assumption(0.95, eps_sec=1e-2)
    schedule = schedule_of(claim)
    assert schedule is not None
    world = Recorded(claim, lambda _: False)
    listeners = Listeners(
        {"key-solver": KNOWLEDGE.model_copy(update={"keys": claim})},
        lambda _line: None,
        logging.getLogger("test"),
    )
    (listener,) = listeners.listeners
    most = list[tuple[int, int]]()
    last = size(36, 60)
    for blocks in (10, 11, 20, last):
        while world.journals["plant"].load().record.link.transitions < schedule.begins(blocks) + 9:  # type: ignore[union-attr]
            world.well(20)
        for message in without(world.field, loss, blocks):
            listeners.hear(message)
        world.field.clear()
        keys = listener.belief().keys
        assert not listener.failed
        most.append(kept([listeners]))
    world.close()
    assert keys is not None
    assert keys.blocks >= last - 2
    assert keys.bits > 0
    for now, before in zip(most[-1], map(max, zip(*most[:-1], strict=True)), strict=True):
        assert now < 1.15 * before


def missing(messages: list[FieldMessage], ks: range, count: int) -> list[FieldMessage]:
    """She misses so many offers of these steps, by their nonces alone."""
    gone = set(list(ks)[:count])
    return [
        m.model_copy(update={"copy_number": 1}) if isinstance(m, Offer) and m.k in gone else m
        for m in messages
    ]


def test_one_row_too_many_is_one_combination_of_rows_and_half_of_it_is_of_keys() -> None:
    messages, blocks, _ = recorded()
    second = blocks[1]
    first_k = blocks[0].transitions + 1
    ks = range(first_k, first_k + second.transitions)
    for missed, bits in ((second.rows, 0), (second.rows - 1, 256), (second.rows - 3, 768)):
        assert missed <= len(ks)
        keys = held_by(missing(messages, ks, missed))
        (block,) = (b for b in keys.newest if b.number == 1)
        assert (block.missed, block.bits) == (missed, bits)


def with_one_missed_each(
    messages: list[FieldMessage], blocks: list[ClosedBlock]
) -> list[FieldMessage]:
    k = 1
    for block in blocks:
        messages = missing(messages, range(k + 3, k + 4), 1)
        k += block.transitions
    return messages


def test_who_missed_one_copy_of_each_block_has_no_key_by_itself() -> None:
    messages, blocks, made = recorded()
    messages = with_one_missed_each(messages, blocks)
    assert [(b.missed, b.bits) for b in held_by(messages).newest] == [
        (1, 256 * (b.rows - 1)) for b in blocks
    ]
    assert keys_of(solver_of(messages), made) == [()] * len(made)


@pytest.mark.parametrize("claim", [None, Assumption(0.0)])
def test_where_no_key_is_made_there_is_nothing_for_her(claim: Assumption | None) -> None:
    with pytest.raises(KnowledgeError, match="lacks keys"):
        named("key-solver")(KNOWLEDGE.model_copy(update={"keys": claim}))


def test_knowledge_of_the_claim_travels_as_json() -> None:
    assert Knowledge.model_validate_json(KNOWLEDGE.model_dump_json()) == KNOWLEDGE
