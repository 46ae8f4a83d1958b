"""Key blocks: which transitions make one, and how both ends come to hold the same.

A block is open until its last transition closes it. It is ``stored`` once its keys are on disk, and
``confirmed`` once the partner has shown the same tag. A side announces a block only when it has
confirmed the one before. So the partner is at the same block or at the next, and an equal tag of
the next one confirms both. A block too poor for a key is not announced.

Block b is N_b = min(N, N_0 2^b) transitions. Block 0 begins after the session's first transition:
a jammer may have chosen that one, so it does not count. All of this follows from the transitions'
numbers, which both ends count alike.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from hmac import compare_digest
from typing import Any, Final, Literal, NamedTuple

from protocol.secret.bound import Assumption, least
from protocol.secret.nonces import Contribution

LARGEST_BLOCK: Final = 16384
"""Most transitions of a block: their two nonces each, and the rows, fit the field."""

LARGEST_BY_WORDS: Final = 1024
"""The same where each of the nonces' 16 words is a column."""

ROWS_ENOUGH: Final = 64
"""Blocks grow until they yield so many rows. Longer ones gain little and come later."""

UNCONFIRMED: Final = 2
"""Most blocks that are stored and not confirmed: the one announced, and the next, whose tag is
compared with that of a partner that is further on."""

TAG_DIGITS: Final = 32
NO_TAG: Final = "0" * TAG_DIGITS


@dataclass(frozen=True, slots=True)
class Schedule:
    """Where blocks begin, from the assumption alone.

    Parameters
    ----------
    assumption : Assumption
    first : int
        N_0, the least number of transitions that makes a key where nothing is lost.
    largest : int
        N, the least power of two that makes 64 rows.
    """

    assumption: Assumption
    first: int
    largest: int

    @property
    def growing(self) -> int:
        """How many blocks are shorter than N: N_b is N_0 2^b for those, and N from there on."""
        return (-(-self.largest // self.first) - 1).bit_length()

    def length(self, number: int) -> int:
        """N_b: transitions of block ``number``."""
        return self.first << number if number < self.growing else self.largest

    def begins(self, number: int) -> int:
        """The first transition of block ``number``."""
        grown = min(number, self.growing)
        return 1 + self.first * ((1 << grown) - 1) + (number - grown) * self.largest

    def block_of(self, j: int) -> int:
        """The block of transition ``j``; -1 for the session's first."""
        if j < 1:
            return -1
        grown = self.growing
        b = ((j - 1) // self.first + 1).bit_length() - 1  # N_0 (2^b - 1) came before it
        return b if b < grown else grown + (j - self.begins(grown)) // self.largest


@cache
def schedule_of(assumption: Assumption) -> Schedule | None:
    """The schedule, or None where the assumption makes no key in any block."""

    def enough(rows: int, n: int) -> bool:
        return assumption.rows(n, n, assumption.copies * n) >= rows

    most = LARGEST_BY_WORDS if assumption.by_words else LARGEST_BLOCK
    first = least(lambda n: enough(2, n), most)
    if first is None:
        return None
    largest = 1
    while largest < most and not enough(ROWS_ENOUGH, largest):
        largest *= 2
    return Schedule(assumption, first, max(largest, first))


class ClosedBlock(NamedTuple):
    """A block whose last transition has been counted, with all that its keys are made of.

    Parameters
    ----------
    session, number
        Session and number of the block.
    transitions, steps, counted : int
        Transitions N, steps (missed ones included), and copies 0 that count.
    rows : int
        R. Below 2 the block makes no key.
    nonces : tuple of bytes
        Nonces that count, in the order of transitions, an offer's before its measurement's.
    last : int
        Number of the block's last transition.
    by_words : bool
        The matrix works on words of 16 bits in place of whole nonces.
    """

    session: str
    number: int
    transitions: int
    steps: int
    counted: int
    rows: int
    nonces: tuple[bytes, ...]
    last: int
    by_words: bool = False

    @property
    def makes_keys(self) -> bool:
        """Whether there are rows for a tag and a key."""
        return self.rows >= 2


class OpenBlock:
    """A block under way. It takes rows as they come, so its last step costs no more than others."""

    def __init__(self, assumption: Assumption) -> None:
        self._assumption = assumption
        self._steps = 0
        self._nonces: list[bytes] = []
        self._transitions = 0

    @property
    def empty(self) -> bool:
        """Whether it has no row yet."""
        return not self._transitions

    def add(self, contribution: Contribution) -> None:
        """Add the row of the next transition."""
        counts = self._assumption.counting(contribution.counts)
        if counts & 1 and contribution.offer is not None:
            self._nonces.append(contribution.offer)
        if counts & 2 and contribution.measurement is not None:
            self._nonces.append(contribution.measurement)
        self._transitions += 1
        self._steps += contribution.steps

    def close(self, session: str, number: int, last: int) -> ClosedBlock:
        """The closed block ``number``; the row of transition ``last`` was its last one."""
        n, steps, counted = self._transitions, self._steps, len(self._nonces)
        return ClosedBlock(
            session,
            number,
            n,
            steps,
            counted,
            self._assumption.rows(n, steps, counted),
            tuple(self._nonces),
            last,
            self._assumption.by_words,
        )


class Stored(NamedTuple):
    """A block that is on disk.

    Parameters
    ----------
    session, number
        Session and number of the block.
    tag : str
        Its tag, the same at both ends; empty: the block made no key and is not announced.
    confirmed : bool
        It was confirmed before this process began.
    keys : int
        Keys that were made of it.
    older : bool
        It began before its store did, so its keys may have been given.
    """

    session: str
    number: int
    tag: str
    confirmed: bool = False
    keys: int = 0
    older: bool = False


class BlockResult(NamedTuple):
    """What the partner's announcement means for a stored block.

    It goes to the key maker as a task, comes back with the ``keys`` of the block once it is on
    disk, and is traced.
    """

    session: str
    number: int
    what: Literal["confirmed", "unequal"]
    keys: int = 0

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {
            "event": "judged",
            "session": self.session,
            "number": self.number,
            "what": self.what,
        }


class Blocks:
    """One end's view of its session's blocks, sans I/O.

    Parameters
    ----------
    schedule : Schedule
    session : str
    block, tag
        The last announcement of this end, as read back from its journal.
    contributions : iterable of Contribution
        Rows of transitions whose block is open or not confirmed, as read back.

    Attributes
    ----------
    began : bool
        Whether the last row was the first one of its block.
    """

    def __init__(
        self,
        schedule: Schedule,
        session: str,
        block: int = -1,
        tag: str = NO_TAG,
        contributions: Iterable[Contribution] = (),
    ) -> None:
        self.schedule = schedule
        self.session = session
        self.block = block
        self.tag = tag or NO_TAG
        self._open = OpenBlock(schedule.assumption)
        self._stored: dict[int, Stored] = {}
        self._judged: set[int] = set()
        self._confirmed = block
        self._unequal = False
        self._closed: list[ClosedBlock] = []
        self._kept: set[int] = set()
        self._newest = -1
        self.began = False
        for contribution in contributions:
            self.count(contribution)
        # what stood before the block announced was confirmed, or it would not have been announced
        if any(closed.number == block and closed.makes_keys for closed in self._closed):
            self._confirmed = block - 1

    def count(self, contribution: Contribution) -> None:
        """Add the row of the next transition."""
        self.began = self._open.empty
        self._open.add(contribution)
        self._newest = contribution.j
        number = self.schedule.block_of(contribution.j)
        if contribution.j + 1 == self.schedule.begins(number + 1):
            closed = self._open.close(self.session, number, contribution.j)
            self._open = OpenBlock(self.schedule.assumption)
            assert closed.transitions == self.schedule.length(number), "a row is missing"
            self._closed.append(closed)

    def to_keep(self) -> ClosedBlock | None:
        """The next block to store, once; None while there is none, or two are unconfirmed."""
        if not self._closed or sum(n > self._confirmed for n in self._kept) >= UNCONFIRMED:
            return None
        block = self._closed.pop(0)
        self._kept.add(block.number)
        return block

    def stored(self, block: Stored) -> tuple[BlockResult, ...]:
        """Note that a block is on disk. Blocks of former sessions are ignored.

        Returns
        -------
        tuple of BlockResult
            A verdict that was reached before a restart and not written down.
        """
        if block.session != self.session:
            return ()
        if not block.tag:
            self._judged.add(block.number)
            self._kept.discard(block.number)
            return ()
        self._stored[block.number] = block
        if block.confirmed:
            self._confirmed = max(self._confirmed, block.number)
            self._judged.add(block.number)
        elif block.number <= self._confirmed:
            return (BlockResult(self.session, block.number, "confirmed"),)
        return ()

    def announcement(self) -> tuple[int, str]:
        """The block to announce in the next new message, with its tag.

        A block is announced once a later transition was counted. The partner has then counted the
        block's last transition. Otherwise an end put back from a copy could count that one
        differently, in the same session, and sign a second time.
        """
        if self._confirmed >= self.block:
            following = min((n for n in self._stored if n > self.block), default=None)
            if following is not None and self._newest >= self.schedule.begins(following + 1):
                self.block, self.tag = following, self._stored[following].tag
        return self.block, self.tag

    def heard(self, block: int, tag: str) -> tuple[BlockResult, ...]:
        """Compare the partner's announcement: which blocks it confirms, or that one differs."""
        mine = self._stored.get(block)
        if mine is None or block <= self._confirmed or self._unequal:
            return ()
        if not compare_digest(tag, mine.tag):
            self._unequal = True
            return (BlockResult(self.session, block, "unequal"),)
        done = sorted(n for n in self._stored if self._confirmed < n <= block)
        self._confirmed = block
        return tuple(BlockResult(self.session, n, "confirmed") for n in done)

    @property
    def waiting(self) -> int:
        """Whole blocks that are not confirmed and make keys, as far as is known.

        A block that waits for one further transition is not among them.
        """
        closed = {block.number for block in self._closed if block.makes_keys}
        kept = {n for n in self._kept if n not in self._judged}
        return sum(
            n > self._confirmed and self._newest >= self.schedule.begins(n + 1)
            for n in closed | kept
        )

    def judged(self, session: str, number: int) -> None:
        """Note that a result of :meth:`heard` is on disk."""
        if session == self.session:
            self._judged.add(number)

    def obsolete_rows(self) -> tuple[range, ...]:
        """Transitions whose rows can be erased, returned once.

        Rows are kept until their block is confirmed on disk and this end has announced it.
        """
        over = {n for n in self._judged if n <= self.block or n not in self._stored}
        self._judged -= over
        for number in over:
            self._stored.pop(number, None)
            self._kept.discard(number)
        begins = self.schedule.begins
        return tuple(range(begins(n), begins(n + 1)) for n in sorted(over))
