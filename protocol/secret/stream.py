"""The key stream: digits of the blocks that both ends have confirmed, and how far they are used.

Each confirmed block gives keys, and each key gives base-M digits. The controller names digits in
its offers by their position: the block, and the number of the digit within it. Positions only move
on. A new offer takes the next digits whether or not it is applied, and a repeated offer repeats its
position. The plant takes digits that it still holds, and drops them and all that stand before them
once they have served, so no digit serves twice.

The stream holds the :data:`BLOCKS` newest blocks. The controller leaves the oldest
:data:`UNUSED` of these unused. So the plant may be one block ahead, and either end may confirm two
blocks at once while an offer is on its way, and both still hold every digit that is named.
"""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from protocol.secret.key_digits import digits

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
    """The unused digits of one key of a block, as the journal keeps them.

    Parameters
    ----------
    block, number : int
        The block, and which of its keys.
    first : int
        Number within the block of the first digit that is left.
    digits : bytes
        The digits that are left, one a byte. A part without any is to be erased.
    """

    block: int
    number: int
    first: int
    digits: bytes

    @property
    def begins(self) -> Position:
        """Position of the first digit that is left."""
        return Position(self.block, self.first)

    def since(self, position: Position) -> "Part":
        """This part without the digits that stand before ``position``."""
        if position <= self.begins:
            return self
        if position.block > self.block:
            return self._replace(digits=b"")
        gone = min(position.at - self.first, len(self.digits))
        return self._replace(first=self.first + gone, digits=self.digits[gone:])


class Stream:
    """One end's digits of one session, sans I/O.

    Parameters
    ----------
    size : int
        M.
    parts : iterable of Part
        As read back from the journal.
    after : Position
        Digits before this one have served, or may have: none of them is named again.
    """

    def __init__(self, size: int, parts: Iterable[Part] = (), after: Position = NOWHERE) -> None:
        self._size = size
        self._parts = sorted(part for part in parts if part.digits)
        self._after = after

    @property
    def left(self) -> int:
        """Digits that are held."""
        return sum(len(part.digits) for part in self._parts)

    def add(self, block: int, keys: Sequence[bytes]) -> tuple[Part, ...]:
        """Add the keys of a block that both ends have confirmed.

        Parameters
        ----------
        block : int
            Beyond all that were added before.
        keys : sequence of bytes
            32 bytes each.

        Returns
        -------
        tuple of Part
            Rows of the journal that change: the new ones, and those of blocks that have become too
            old, without digits.
        """
        made: list[Part] = []
        first = 0
        for number, key in enumerate(keys):
            part = Part(block, number, first, bytes(digits(key, self._size)))
            first += len(part.digits)
            if part.digits:
                made.append(part)
        self._parts += made
        return (*self.drop_before(Position(block - BLOCKS + 1, 0)), *made)

    def name(self, count: int, up_to: int) -> Position:
        """The next ``count`` digits that no offer has named; :data:`NOWHERE` where there are none.

        All of them are digits of one key, of block ``up_to`` or an earlier one. The position moves
        on, whatever becomes of the offer.
        """
        newest = self._parts[-1].block if self._parts else -1
        after = max(self._after, Position(newest - BLOCKS + 1 + UNUSED, 0))
        for part in self._parts[max(0, self._place(after)) :]:
            left = part.since(after)
            if part.block > up_to:
                break
            if len(left.digits) >= count:
                self._after = Position(left.block, left.first + count)
                return left.begins
        return NOWHERE

    def at(self, position: Position, count: int) -> tuple[int, ...] | None:
        """The ``count`` digits at a position, or None where they are not held."""
        place = self._place(position)
        if position.block < 0 or place < 0:
            return None
        part = self._parts[place]
        found = part.since(position).digits[:count]
        if part.block != position.block or len(found) < count:
            return None
        return tuple(found)

    def drop_before(self, position: Position) -> tuple[Part, ...]:
        """Erase all digits that stand before ``position``; the rows of the journal that change."""
        place = max(0, self._place(position))
        changed = [part._replace(digits=b"") for part in self._parts[:place]]
        del self._parts[:place]
        if self._parts:
            left = self._parts[0].since(position)
            if left is not self._parts[0]:
                changed.append(left)
                self._parts[:1] = [left] if left.digits else []
        return tuple(changed)

    def _place(self, position: Position) -> int:
        """Number of the last part that begins at ``position`` or before; -1 where none does."""
        return bisect_right(self._parts, position, key=_begins) - 1


def _begins(part: Part) -> Position:
    return part.begins
