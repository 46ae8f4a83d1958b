"""The key stream: each digit is named once, held until it has served, and gone afterwards."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from protocol.secret.key_digits import digits
from protocol.secret.stream import BLOCKS, NOWHERE, KeyStream, Position

SIZES = st.sampled_from([2, 3, 4, 16])
KEYS = st.lists(st.binary(min_size=32, max_size=32), min_size=1, max_size=3)


def in_order(keys: list[bytes], size: int) -> list[int]:
    return [digit for key in keys for digit in digits(key, size)]


@given(SIZES, KEYS, st.integers(1, 2))
def test_both_ends_find_the_same_digits_in_order_and_each_once(
    size: int, keys: list[bytes], count: int
) -> None:
    controller, plant = KeyStream(size), KeyStream(size)
    controller.add(0, keys)
    plant.add(0, keys)
    whole = in_order(keys, size)
    named: list[Position] = []
    while (position := controller.name(count, 0)) != NOWHERE:
        assert plant.at(position, count) == tuple(whole[position.at : position.at + count])
        assert controller.at(position, count) == plant.at(position, count)
        named.append(position)
        plant.drop_before(Position(position.block, position.at + count))
        assert plant.at(position, count) is None
    assert all(b.at >= a.at + count for a, b in pairwise(named))
    assert len(whole) - len(named) * count <= (count - 1) * len(keys)
    assert controller.left == len(whole)


def test_what_is_named_is_held_until_it_has_served_whoever_confirms_two_blocks_at_once() -> None:
    controller, plant = KeyStream(4), KeyStream(4)
    keys = [[bytes([block]) * 32] for block in range(5 * BLOCKS)]
    plant.add(0, keys[0])
    for block in range(0, len(keys) - 3, 2):
        for at in (block + 1, block + 2):
            plant.add(at, keys[at])
        position = controller.name(1, 99)
        controller.add(block, keys[block])
        controller.add(block + 1, keys[block + 1])
        if position != NOWHERE:
            assert controller.at(position, 1) is not None
            assert plant.at(position, 1) == controller.at(position, 1)
    assert len({part for part in range(5 * BLOCKS) if plant.at(Position(part, 0), 1)}) == BLOCKS


def test_what_is_not_held_has_no_digits() -> None:
    stream = KeyStream(4)
    stream.add(3, [bytes(32)])
    assert stream.at(NOWHERE, 1) is None
    assert stream.at(Position(2, 0), 1) is None
    assert stream.at(Position(4, 0), 1) is None
    assert stream.at(Position(3, 127), 2) is None
    assert stream.at(Position(3, 126), 2) == (0, 0)


def test_no_digit_is_named_of_a_block_that_was_not_announced() -> None:
    stream = KeyStream(4)
    stream.add(0, [bytes(32)])
    stream.add(1, [bytes(32)])
    assert [stream.name(2, 0).at for _ in range(64)] == list(range(0, 128, 2))
    assert stream.name(2, 0) == NOWHERE
    assert stream.name(2, 1) == Position(1, 0)
