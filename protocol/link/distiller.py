"""What both ends do alike for keys, sans I/O: nonces, rows, blocks, announcements, the key stream.

A block is open until its last transition closes it. Its keys are then extracted, in a thread of
their own. It is *announced* with its tag, and *confirmed* once the partner has shown the
same tag: then its digits join the stream. A side announces a block only when it has confirmed the
one before. So the partner is at the same block or at the next, and an equal tag of the next one
confirms both. A block too poor for a key is not announced.

All of it belongs to one session, and is void with it. A scenario without keys has a
:class:`Distiller` too. It gives the constants that the wire then carries, and wants nothing done.
"""

from collections.abc import Iterable
from hmac import compare_digest
from typing import Any, Final, Literal, NamedTuple

from protocol.link.records import KeyRecord, LinkRecord
from protocol.messages import Measurement, Offer
from protocol.messages.management import KeyStatus
from protocol.secret.blocks import NO_TAG, ClosedBlock, ExtractedBlock, OpenBlock, Schedule
from protocol.secret.nonces import (
    FIRST,
    Contribution,
    Copy,
    NonceSource,
    contribution_of,
)
from protocol.secret.stream import (
    NO_PART,
    NOTHING_HELD,
    NOWHERE,
    BlockKeys,
    Held,
    KeyStream,
    Part,
    Position,
)

UNCONFIRMED: Final = 2
"""Most blocks that are extracted and not confirmed: the one announced, and the next, whose tag is
compared with that of a partner that is further on."""


class BlockEnded(NamedTuple):
    """What became of a key block, as it is traced.

    ``confirmed``: both ends hold its keys. ``unequal``: they differ, and the session ends.
    ``poor``: too many copies were lost to make a key of it.
    """

    session: str
    number: int
    what: Literal["confirmed", "unequal", "poor"]
    keys: int = 0

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "block", **self._asdict()}


class KeyRows(NamedTuple):
    """Rows of the journal that change with the next save.

    Parameters
    ----------
    contributions : tuple of Contribution
        Of transitions that were counted since the last save.
    obsolete_rows : tuple of range
        Transitions whose rows no block needs any more.
    keys : tuple of BlockKeys
        Of blocks whose row in the stream changes; one without any is to be erased.
    part : Part
        The stream's key in use, as it is now.
    """

    contributions: tuple[Contribution, ...] = ()
    obsolete_rows: tuple[range, ...] = ()
    keys: tuple[BlockKeys, ...] = ()
    part: Part = NO_PART


NO_ROWS: Final = KeyRows()


class Distiller:
    """One end's part in making keys of its session.

    Parameters
    ----------
    schedule : Schedule, optional
        None: no keys.
    size : int
        M, for the digits of the stream.
    fresh : NonceSource

    Attributes
    ----------
    session : str
        Empty while there is none.
    record : KeyRecord
    stream : KeyStream
    made, lost : int
        Keys made, and blocks that made none, since this process began.
    on : bool
        Whether keys are made.
    last : tuple of int
        Keys and transitions of the block confirmed last.
    stopped : str
        Why the newest block made no key; empty where it made some.
    broken : str
        Why no key is made any more; empty where some are.
    appearances : int
        Times that a message leaves this end, as its host has counted last.
    crowded : str
        Why copies that leave this end now do not count for keys; empty where they do.
    unequal : bool
        A block differs from the partner's, and :meth:`ended` has told so.
    """

    def __init__(self, schedule: Schedule | None, size: int, fresh: NonceSource) -> None:
        self.schedule = schedule
        self.made = self.lost = 0
        self.last = (0, 0)
        self.stopped = self.broken = self.crowded = ""
        self.appearances = 1
        self.on = schedule is not None
        self._size = size
        self._fresh = fresh
        self.resume("", KeyRecord())

    def begin(self, session: str) -> None:
        """Begin a session, or (empty) none: keys of the one before are void."""
        kept = KeyRecord(begun=self.record.begun, refuted=self.record.refuted)
        self.resume(session, kept)

    def resume(
        self,
        session: str,
        record: KeyRecord,
        rows: Iterable[Contribution] = (),
        held: Held = NOTHING_HELD,
        after: Position = NOWHERE,
    ) -> None:
        """Go on with a session from what was read back.

        Parameters
        ----------
        session : str
        record : KeyRecord
        rows : iterable of Contribution
            Of transitions whose block is open, not confirmed or not announced.
        held : Held
            What is left of the stream.
        after : Position
            Digits before it may have served.
        """
        self.session = session
        self.record = record._replace(tag=record.tag or (NO_TAG if self.on else ""))
        self.broken = self.broken or record.refuted
        self.stream = KeyStream(self._size, held, after)
        self._newest = -1
        self._number = self._following = -1  # of the open block, and where the next one begins
        self._closed: list[ClosedBlock] = []
        self._wanted: set[int] = set()
        self._extracted: dict[int, ExtractedBlock] = {}
        self.unequal = self._unequal = False
        self._over: set[int] = set()
        self._ended: list[BlockEnded] = []
        self._keys: list[BlockKeys] = []
        self._rows: list[Contribution] = []
        self.stopped = ""
        if self.schedule is not None:
            self._open = OpenBlock(self.schedule.assumption)
            for row in rows:
                self._count(self.schedule, row)

    # --- nonces and copies ------------------------------------------------------------------------

    def nonce(self) -> str:
        """A fresh nonce."""
        return self._fresh() if self.on else ""

    def copy(self) -> Copy:
        """Number of a step's first copy: 0, or 1 where it leaves too often to count (rule 8)."""
        return 1 if self.crowded else FIRST

    def appear(self, count: int) -> bool:
        """Note how often a message leaves from here on. True where that starts or stops keys.

        The claim holds for ``keys.appearances`` appearances of a message.
        """
        before = self.crowded
        self.appearances, self.crowded = count, ""
        if self.schedule is not None and count > self.schedule.assumption.appearances:
            stated = self.schedule.assumption.appearances
            self.crowded = (
                f"a message leaves {count} times, and keys.appearances = {stated} was stated"
            )
        return (self.crowded == "") != (before == "")

    def again(self, offer: Offer) -> Offer:
        """Another copy of an offer that may have left, with a dummy for its nonce (rule 8)."""
        if not self.on:
            return offer
        return offer.model_copy(update={"copy_number": 1, "nonce": self.nonce()})

    # --- rows and blocks --------------------------------------------------------------------------

    def count(self, link: LinkRecord, offer: Offer, applied_copy: int) -> int:
        """Take the row of the transition that ``offer``, applied in its ``applied_copy``, made of
        ``link`` (rule 9); which copies count, as :attr:`Contribution.counts` says."""
        if self.schedule is None or not self.session or link.transitions == 0:
            return 0  # a session's first transition only fixes where block 0 begins
        row = contribution_of(
            j=link.transitions,
            steps=offer.k - link.applied_k,
            offer=offer.nonce,
            applied_copy=applied_copy,
            measurement=link.nonce,
            heard=offer.heard,
        )
        if not self._open.pattern:
            self.record = self.record._replace(begun=self.record.begun + 1)
        self._count(self.schedule, row)
        self._rows.append(row)
        return row.counts

    def _count(self, schedule: Schedule, row: Contribution) -> None:
        if not self._open.pattern:
            self._number = schedule.block_of(row.j)
            self._following = schedule.begins(self._number + 1)
        self._open.add(row)
        self._newest = row.j
        if row.j + 1 != self._following:
            return
        number = self._number
        closed = self._open.close(self.session, number, row.j)
        self._open = OpenBlock(schedule.assumption)
        assert closed.transitions == schedule.length(number), "a row is missing"
        if number <= min(self.record.confirmed, self.record.block):
            self._over.add(number)
        elif closed.makes_keys:
            self._closed.append(closed)
        else:
            self._over.add(number)
            self._end(BlockEnded(self.session, number, "poor"), "lost too many copies to make one")

    def extracted(self, block: ExtractedBlock) -> None:
        """Note the tag and keys of a block; those of former sessions are ignored."""
        if block.session == self.session and block.number in self._wanted:
            self._extracted[block.number] = block
            if block.number <= self.record.confirmed:
                self._over.add(block.number)

    def fail(self, why: str) -> None:
        """Make no key from here on: blocks cannot be extracted, or the claim is refuted."""
        self.broken = self.broken or why

    def refute(self, why: str) -> None:
        """The claim that keys rest on does not hold: make none, in this session or a later one."""
        self.record = self.record._replace(refuted=why)
        self.fail(why)

    def announcement(self) -> tuple[int, str]:
        """The block to announce in the next new message, with its tag.

        A block is announced once a later transition was counted. The partner has then counted the
        block's last transition. Otherwise an end put back from a copy could count that one
        differently, in the same session.
        """
        record = self.record
        if self._extracted and not self.broken and record.confirmed >= record.block:
            assert self.schedule is not None
            following = min((n for n in self._extracted if n > record.block), default=None)
            if following is not None and self._newest >= self.schedule.begins(following + 1):
                self.record = record._replace(block=following, tag=self._extracted[following].tag)
        return self.record.block, self.record.tag

    def compare(self, message: Measurement | Offer) -> None:
        """Compare the partner's announcement: it confirms blocks, or shows that one differs."""
        mine = self._extracted.get(message.block)
        confirmed = self.record.confirmed
        if mine is None or message.block <= confirmed or self._unequal or self.broken:
            return
        if not compare_digest(message.tag, mine.tag):
            self._unequal = True
            ended = BlockEnded(self.session, message.block, "unequal")
            self._end(ended, "differs from the partner's")
            return
        for number in sorted(self._extracted):
            if confirmed < number <= message.block:
                self._confirm(self._extracted[number])

    def awaits(self, block: int) -> bool:
        """Whether this end has announced a block, and is yet to confirm it.

        So it is after a death, until the block is extracted again; or while the next block, which
        the partner has announced by now, is not extracted here.
        """
        return self.record.confirmed < block <= self.record.block and not self.broken

    def _confirm(self, block: ExtractedBlock) -> None:
        assert self.schedule is not None
        self.record = self.record._replace(confirmed=block.number)
        self._over.add(block.number)
        self._keys += self.stream.add(block.number, block.keys)
        self.made += len(block.keys)
        self.last = (len(block.keys), self.schedule.length(block.number))
        self._end(BlockEnded(self.session, block.number, "confirmed", len(block.keys)))

    def _end(self, block: BlockEnded, why_not: str = "") -> None:
        self._ended.append(block)
        self.lost += bool(why_not)
        self.stopped = f"block {block.number} {why_not}" if why_not else ""

    # --- the stream -------------------------------------------------------------------------------

    def used(self, position: Position, count: int) -> None:
        """``count`` digits at a position have served: they and all before them are erased."""
        if position != NOWHERE:
            self._keys += self.stream.drop_before(Position(position.block, position.at + count))

    # --- what is to be done -----------------------------------------------------------------------

    def ended(self) -> tuple[BlockEnded, ...]:
        """What became of blocks since the last time."""
        ended, self._ended = tuple(self._ended), []
        self.unequal = self._unequal
        return ended

    def tasks(self) -> tuple[ClosedBlock, ...]:
        """Blocks to be extracted now; each once."""
        tasks: list[ClosedBlock] = []
        while self._closed and not self.broken:
            if sum(number > self.record.confirmed for number in self._wanted) >= UNCONFIRMED:
                break
            tasks.append(self._closed.pop(0))
            self._wanted.add(tasks[-1].number)
        return tuple(tasks)

    def rows(self) -> KeyRows:
        """What the journal must save with the record, once."""
        if self.schedule is None:
            return NO_ROWS
        obsolete = self._obsolete(self.schedule) if self._over else ()
        rows = KeyRows(tuple(self._rows), obsolete, tuple(self._keys), self.stream.part)
        self._rows, self._keys = [], []
        return rows

    def _obsolete(self, schedule: Schedule) -> tuple[range, ...]:
        """Transitions of blocks that are over, and no longer announced in an older message."""
        over = {n for n in self._over if n <= self.record.block or n not in self._wanted}
        self._over -= over
        for number in over:
            self._extracted.pop(number, None)
            self._wanted.discard(number)
        return tuple(range(schedule.begins(n), schedule.begins(n + 1)) for n in sorted(over))

    def status(self) -> KeyStatus:
        """What a status says of keys."""
        of_block, steps = self.last
        return KeyStatus.model_construct(
            made=self.made,
            lost=self.lost,
            begun=self.record.begun,
            of_block=of_block,
            block_steps=steps,
            refused=self.broken,
            stopped=self.crowded or self.stopped,
            digits_left=self.stream.left,
            appearances=self.appearances,
        )
