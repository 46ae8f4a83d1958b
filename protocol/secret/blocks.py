"""Blocks: which transitions make one key block, and how both ends come to hold the same.

A block is ``open``, then closed by its last transition, ``stored`` once its keys are on disk, and
``confirmed`` once the partner has shown the same tag for it. A side announces a block only when it
has confirmed the one before; so the partner is at the same block or at the next, and a tag of the
next one that holds confirms both. Blocks too poor for a key are announced by nobody.

The session's first transition only fixes where block 0 begins: counted, it would be the one that a
jammer chose. Block b is the N_b transitions after that, N_b = min(N, N_0 2^b), and everything
about it follows from the transitions' numbers, which both ends count alike.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from hmac import compare_digest
from typing import Final, Literal, NamedTuple

from protocol.secret.bound import Assumption, least
from protocol.secret.nonces import Contribution
from protocol.secret.records import block_name

LARGEST_BLOCK: Final = 16384
"""Transitions of a block: two nonces of each and the rows fit the field."""

LARGEST_BY_WORDS: Final = 1024
"""The same where each of a nonce's 16 words has a column of its own."""

ROWS_ENOUGH: Final = 64
"""A block that yields as many rows is long enough: longer ones gain less and wait more."""

UNCONFIRMED: Final = 2
"""Blocks that are stored and not confirmed: the one announced, and the next, by whose tag a partner
that is further on is judged. Each holds a pad; no more are spent on a partner that is away."""

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

    def length(self, number: int) -> int:
        """N_b: transitions of block ``number``."""
        return min(self.largest, self.first << min(number, 32))

    def begins(self, number: int) -> int:
        """The first transition of block ``number``."""
        total, b = 1, 0
        while b < number and self.length(b) < self.largest:
            total += self.length(b)
            b += 1
        return total + (number - b) * self.largest

    def block_of(self, j: int) -> int:
        """The block of transition ``j``; -1 for the session's first."""
        if j < 1:
            return -1
        b = 0
        while self.length(b) < self.largest and j >= self.begins(b + 1):
            b += 1
        return b + max(0, j - self.begins(b)) // self.length(b)


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
    """A block whose last transition has been counted: all that its keys are made of.

    Parameters
    ----------
    session, number
        Whose block it is, and which.
    transitions, steps, counted : int
        N, K and C; L = copies K - C.
    rows : int
        R; below 2 it makes no key.
    pattern : str
        For each transition 0, 1, 2 or 3: no copy counts, the offer's, the measurement's, both.
    nonces : tuple of bytes
        The counted copies in the order of the transitions, an offer's before its measurement's.
    last : int
        Number of the block's last transition.
    by_words : bool
        Keys are made of the nonces' words, not of whole nonces.
    """

    session: str
    number: int
    transitions: int
    steps: int
    counted: int
    rows: int
    pattern: str
    nonces: tuple[bytes, ...]
    last: int
    by_words: bool = False

    @property
    def makes_keys(self) -> bool:
        """Whether the rows are enough for a tag and a key."""
        return self.rows >= 2

    @property
    def name(self) -> str:
        """SESSION/NUMBER, the block's name in ids and ledgers."""
        return block_name(self.session, self.number)

    def message(self) -> bytes:
        """Everything that the two ends must agree on, as bytes that say it in one way only."""
        head = f"{self.name}/{self.transitions}/{self.steps}/{self.pattern}/"
        return head.encode() + b"".join(self.nonces)


class OpenBlock:
    """A block under way. Each row is taken in as it comes: the step that closes it does no more."""

    def __init__(self, assumption: Assumption) -> None:
        self._assumption = assumption
        self._steps = 0
        self._nonces: list[bytes] = []
        self._pattern: list[str] = []

    @property
    def empty(self) -> bool:
        """Whether no row was taken yet."""
        return not self._pattern

    def add(self, contribution: Contribution) -> None:
        """Take the row of the next transition."""
        counts = self._assumption.counting(contribution.counts)
        if counts & 1 and contribution.offer is not None:
            self._nonces.append(contribution.offer)
        if counts & 2 and contribution.measurement is not None:
            self._nonces.append(contribution.measurement)
        self._pattern.append(str(counts))
        self._steps += contribution.steps

    def close(self, session: str, number: int, last: int) -> ClosedBlock:
        """The block ``number`` once the row of transition ``last`` has been taken."""
        n, steps, counted = len(self._pattern), self._steps, len(self._nonces)
        return ClosedBlock(
            session,
            number,
            n,
            steps,
            counted,
            self._assumption.rows(n, steps, counted),
            "".join(self._pattern),
            tuple(self._nonces),
            last,
            self._assumption.by_words,
        )


class Stored(NamedTuple):
    """A block is on disk: its own tag, and that of the partner which would confirm it.

    No tag: the block made no key, and nobody announces it; ``exhausted`` says that there was no pad
    to sign it with, ``older`` that it began before its store did. ``confirmed`` says that it was
    confirmed before this process began. ``keys`` were made of it. ``signed`` names the set of pads
    that its tag was made with; empty where tags are public.
    """

    session: str
    number: int
    tag: str
    accepted: str = ""
    confirmed: bool = False
    keys: int = 0
    exhausted: bool = False
    older: bool = False
    signed: str = ""


class BlockResult(NamedTuple):
    """What the partner's word says of a stored block."""

    number: int
    what: Literal["confirmed", "unequal"]


class Blocks:
    """One end's view of its session's blocks, sans I/O.

    Parameters
    ----------
    schedule : Schedule
    session : str
    block, tag
        What this end has announced last, as read back.
    raws : iterable of Raw
        Rows of transitions whose block is open or not settled, as read back.

    Attributes
    ----------
    began : bool
        Whether the row taken last was the first one of its block.
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
        self._settled: set[int] = set()
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
        """Take the row of the next transition."""
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
        """The next block to be stored, once; None while there is none, or two are unconfirmed."""
        if not self._closed or sum(n > self._confirmed for n in self._kept) >= UNCONFIRMED:
            return None
        block = self._closed.pop(0)
        self._kept.add(block.number)
        return block

    def stored(self, block: Stored) -> tuple[BlockResult, ...]:
        """A block is on disk; those of a session that is over are of no concern.

        A verdict that was reached before a start, but not yet on disk, is told once more.
        """
        if block.session != self.session:
            return ()
        if not block.tag:
            self._settled.add(block.number)
            self._kept.discard(block.number)
            return ()
        self._stored[block.number] = block
        if block.confirmed:
            self._confirmed = max(self._confirmed, block.number)
            self._settled.add(block.number)
        elif block.number <= self._confirmed:
            return (BlockResult(block.number, "confirmed"),)
        return ()

    def word(self) -> tuple[int, str]:
        """The block to announce in the next new message, with its tag.

        Not before a later transition was counted. The partner has then counted the block's last
        one, which an end that is put back from a copy could else count otherwise, in the same
        session, and sign once more.
        """
        if self._confirmed >= self.block:
            following = min((n for n in self._stored if n > self.block), default=None)
            if following is not None and self._newest >= self.schedule.begins(following + 1):
                self.block, self.tag = following, self._stored[following].tag
        return self.block, self.tag

    def heard(self, block: int, tag: str) -> tuple[BlockResult, ...]:
        """Judge the partner's word: which blocks it confirms, or that it differs."""
        mine = self._stored.get(block)
        if mine is None or block <= self._confirmed or self._unequal:
            return ()
        if not compare_digest(tag, mine.accepted):
            self._unequal = True
            return (BlockResult(block, "unequal"),)
        done = sorted(n for n in self._stored if self._confirmed < n <= block)
        self._confirmed = block
        return tuple(BlockResult(n, "confirmed") for n in done)

    @property
    def waiting(self) -> int:
        """Blocks that are whole and not confirmed, and make keys as far as is known.

        Not one that only a further transition may announce.
        """
        closed = {block.number for block in self._closed if block.makes_keys}
        kept = {n for n in self._kept if n not in self._settled}
        return sum(
            n > self._confirmed and self._newest >= self.schedule.begins(n + 1)
            for n in closed | kept
        )

    def judged(self, session: str, number: int) -> None:
        """A judgement of :meth:`heard` is on disk."""
        if session == self.session:
            self._settled.add(number)

    def obsolete_rows(self) -> tuple[range, ...]:
        """Transitions whose rows nobody needs any more; they are named once.

        A block's are kept until it is confirmed on disk and this end has announced it.
        """
        over = {n for n in self._settled if n <= self.block or n not in self._stored}
        self._settled -= over
        for number in over:
            self._stored.pop(number, None)
            self._kept.discard(number)
        begins = self.schedule.begins
        return tuple(range(begins(n), begins(n + 1)) for n in sorted(over))
