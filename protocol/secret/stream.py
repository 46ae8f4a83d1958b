"""The key stream: digits of the blocks that both ends have confirmed, and how far they are used.

Each confirmed block gives keys, and each key gives base-M digits. The controller names digits in
its offers by their position: the block, and the number of the digit within it. Positions only move
on. A new offer takes the next digits whether or not it is applied, and a repeated offer repeats its
position. The plant takes digits that it still holds, and drops them and all that stand before them
once they have served, so no digit serves twice.

A journal has the keys as they were extracted, a row for each block, and with each step the digits
that are left of the key in use. So a digit that has served is written over with the next step, and
a key is written once.

The stream holds the :data:`BLOCKS` newest blocks. The controller leaves the oldest
:data:`UNUSED` of these unused. So the plant may be one block ahead, and either end may confirm two
blocks at once while an offer is on its way, and both still hold every digit that is named.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from protocol.secret.key_digits import KEY_BYTES, digits, number_of_digits

BLOCKS: Final = 6
"""Newest blocks that the stream holds."""

UNUSED: Final = 3
"""Oldest of these blocks, of which nothing is named."""


class Position(NamedTuple):
    """Where in the stream an offer's digits begin.

    Parameters
    ----------
    block : int
        Number of the block in its session; -1: the offer has no digits.
    at : int
        Number of the first digit within the block.
    """

    block: int
    at: int


NOWHERE: Final = Position(-1, 0)
"""The position of an offer without digits."""


class Part(NamedTuple):
    """The digits that are left of the key in use.

    Parameters
    ----------
    block : int
    first : int
        Number within the block of the first digit that is left.
    digits : bytes
        One a byte.
    """

    block: int
    first: int
    digits: bytes

    @property
    def begins(self) -> Position:
        """Position of the first digit that is left."""
        return Position(self.block, self.first)

    def since(self, position: Position) -> "Part":
        """This part without the digits that stand before ``position``."""
        block, first, digits = self
        if position <= (block, first):
            return self
        if position.block > block:
            return Part(block, first, b"")
        gone = min(position.at - first, len(digits))
        return Part(block, first + gone, digits[gone:])


NO_PART: Final = Part(-1, 0, b"")
"""No key is in use."""


class BlockKeys(NamedTuple):
    """The keys of a block that were not used yet.

    Parameters
    ----------
    block : int
    first : int
        Number within the block of their first digit.
    keys : bytes
        32 bytes each, one behind the other.
    """

    block: int
    first: int
    keys: bytes

    def begun(self, size: int) -> tuple[Part, "BlockKeys"]:
        """The digits of the first key, and the keys behind it."""
        part = Part(self.block, self.first, bytes(digits(self.keys[:KEY_BYTES], size)))
        rest = BlockKeys(self.block, self.first + len(part.digits), self.keys[KEY_BYTES:])
        return part, rest


class Held(NamedTuple):
    """What an end holds of the stream, as its journal keeps it: block after block."""

    part: Part = NO_PART
    keys: tuple[BlockKeys, ...] = ()


NOTHING_HELD: Final = Held()


class KeyStream:
    """One end's digits of one session, sans I/O.

    Parameters
    ----------
    size : int
        M.
    held : Held
        As read back from the journal.
    after : Position
        Digits before this one have served, or may have: none of them is named again.

    Attributes
    ----------
    part : Part
        The key in use; what it holds stands before all else.
    """

    def __init__(self, size: int, held: Held = NOTHING_HELD, after: Position = NOWHERE) -> None:
        self._size = size
        self.part = held.part
        self._keys = list(held.keys)
        self._after = after

    @property
    def left(self) -> int:
        """Digits that are held."""
        whole = sum(number_of_digits(of_block.keys, self._size) for of_block in self._keys)
        return len(self.part.digits) + whole

    def add(self, block: int, keys: Sequence[bytes]) -> tuple[BlockKeys, ...]:
        """Add the keys of a block that both ends have confirmed.

        Parameters
        ----------
        block : int
            Beyond all that were added before.
        keys : sequence of bytes
            32 bytes each.

        Returns
        -------
        tuple of BlockKeys
            Rows of the journal that change: the new one, and those of blocks that have become too
            old, without keys.
        """
        changed = self.drop_before(Position(block - BLOCKS + 1, 0))
        made = BlockKeys(block, 0, b"".join(keys))
        self._keys.append(made)
        return (*changed, made)

    def name(self, count: int, up_to: int) -> Position:
        """The next ``count`` digits that no offer has named; :data:`NOWHERE` where there are none.

        All of them are digits of one key, of block ``up_to`` or an earlier one. The position moves
        on, whatever becomes of the offer.
        """
        newest = self._keys[-1].block if self._keys else self.part.block
        oldest = newest - BLOCKS + 1 + UNUSED
        after = self._after if self._after.block >= oldest else Position(oldest, 0)
        for part in self._since(after):
            if part.block > up_to:
                break
            if len(part.digits) >= count:
                self._after = Position(part.block, part.first + count)
                return part.begins
        return NOWHERE

    def at(self, position: Position, count: int) -> tuple[int, ...] | None:
        """The ``count`` digits at a position, or None where they are not held."""
        of_block, number = position
        if of_block < 0:
            return None
        block, first, digits = self.part
        start = number - first
        if of_block != block or not 0 <= start < len(digits):
            block, first, digits = next(self._since(position), NO_PART)
            if position != (block, first):
                return None
            start = 0
        found = digits[start : start + count]
        return tuple(found) if len(found) == count else None

    def drop_before(self, position: Position) -> tuple[BlockKeys, ...]:
        """Erase all digits that stand before ``position``; the rows of the journal that change."""
        self.part = self.part.since(position)
        if self.part.digits:
            return ()
        changed: dict[int, BlockKeys] = {}
        while self._keys and not self.part.digits:
            keys = self._keys[0]
            if keys.block < position.block:
                rest = keys._replace(keys=b"")
            else:
                part, rest = keys.begun(self._size)
                self.part = part.since(position)
            changed[rest.block] = rest
            self._keys[:1] = [rest] if rest.keys else []
        return tuple(changed.values())

    def _since(self, position: Position) -> Iterator[Part]:
        """What is held from ``position`` on, key by key, without what stands before it."""
        part = self.part.since(position)
        if part.digits:
            yield part
        for keys in self._keys:
            rest = keys
            while rest.keys and rest.block >= position.block:
                part, rest = rest.begun(self._size)
                left = part.since(position)
                if left.digits:
                    yield left
