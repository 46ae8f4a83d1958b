"""What both ends do alike for keys: nonces, announcements of blocks, rows, tasks for the key maker.

A scenario without keys has a :class:`Keying` too. It gives the constants that the wire then
carries, and makes no tasks.
"""

from collections.abc import Iterable
from math import inf
from typing import Any, Final

from protocol.messages import BlockAnnouncement, Measurement, Offer
from protocol.secret.blocks import NO_TAG, BlockResult, Blocks, Schedule, Stored
from protocol.secret.nonces import (
    FIRST,
    Contribution,
    Copy,
    NonceSource,
    contribution_of,
    fresh_nonce,
)
from protocol.secret.records import Side
from protocol.secret.tasks import Broken, Done, Task

NO_PAD_LEFT: Final = "no pad is left to sign key blocks with"


class Keying:
    """One end's part in making keys, sans I/O.

    Parameters
    ----------
    schedule : Schedule, optional
        None: no keys.
    fresh : NonceSource
    """

    def __init__(self, schedule: Schedule | None, fresh: NonceSource = fresh_nonce) -> None:
        self.schedule = schedule
        self.blocks: Blocks | None = None
        self.broken = ""
        self.stopped = ""
        """Why the newest block made no key; empty where it made some."""
        self.lost = 0
        """Blocks that made no key."""
        self.made = 0
        self.last = (0, 0)
        """Keys and steps of the last block confirmed."""
        self._newest = -1.0
        """Number of the newest block of this session that was stored or lost; inf: none will be."""
        self.appearances = 1
        """Times that a message leaves this end, as its host has counted last."""
        self._fresh = fresh
        self._rows: tuple[Contribution, ...] = ()
        """Contributions that were counted, and not saved yet."""

    @property
    def on(self) -> bool:
        """Whether keys are made."""
        return self.schedule is not None

    @property
    def no_tag(self) -> str:
        """The tag while no block is announced."""
        return NO_TAG if self.on else ""

    def begin(
        self,
        session: str,
        block: int = -1,
        tag: str = "",
        contributions: Iterable[Contribution] = (),
    ) -> None:
        """Begin a session, or go on with it from what was read back."""
        self._rows = ()
        if self.schedule is not None:
            self.blocks = Blocks(self.schedule, session, block, tag, contributions)
            self._newest = -1.0
            if self.stopped != NO_PAD_LEFT:  # what became of a former session's blocks is past
                self.stopped = ""

    def end(self) -> None:
        """The session is over: what was not stored is gone."""
        self.blocks = None
        self._rows = ()

    def nonce(self) -> str:
        """A fresh nonce."""
        return self._fresh() if self.on else ""

    @property
    def crowded(self) -> str:
        """Why copies that leave this end now do not count for keys; empty where they do.

        The claim holds for ``keys.appearances`` appearances of a message. By the links that are
        open now a message would appear more often.
        """
        if self.schedule is None:
            return ""
        stated = self.schedule.assumption.appearances
        if self.appearances <= stated:
            return ""
        times = f"{self.appearances} times"
        return f"a message leaves {times}, and keys.appearances = {stated} was stated"

    def copy(self) -> Copy:
        """Number of a step's first copy: 0, or 1 where it leaves too often to count (rule 8)."""
        return 1 if self.crowded else FIRST

    def appear(self, count: int) -> bool:
        """Note how often a message leaves from here on. True where that starts or stops keys."""
        before = self.crowded
        self.appearances = count
        return bool(self.crowded) != bool(before)

    def announcement(self) -> tuple[int, str]:
        """The block to announce in a new message, with its tag."""
        return (-1, self.no_tag) if self.blocks is None else self.blocks.announcement()

    def again(self, offer: Offer) -> Offer:
        """Another copy of an offer that may have left, with a dummy for its nonce (rule 8)."""
        if not self.on:
            return offer
        return offer.model_copy(update={"copy_number": 1, "nonce": self.nonce()})

    def count(
        self, j: int, steps: int, offer: Offer, applied_copy: int, measurement: str
    ) -> Contribution | None:
        """What transition ``j`` contributes (rule 9).

        Parameters
        ----------
        j, steps : int
        offer : Offer
            That was applied, in its copy ``applied_copy``.
        measurement : str
            Nonce of copy 0 of the measurement that it answers.
        """
        if self.blocks is None or j == 0:
            return None  # a session's first transition only fixes where block 0 begins
        contribution = contribution_of(
            j=j,
            steps=steps,
            offer=offer.nonce,
            applied_copy=applied_copy,
            measurement=measurement,
            heard=offer.heard,
        )
        self.blocks.count(contribution)
        self._rows = (*self._rows, contribution)
        return contribution

    def heard(self, message: Measurement | Offer | BlockAnnouncement) -> tuple[BlockResult, ...]:
        """Results of this end's blocks that follow from the partner's announcement."""
        return () if self.blocks is None else self.blocks.heard(message.block, message.tag)

    @property
    def waiting(self) -> int:
        """Blocks that are whole and that the partner has not confirmed."""
        return 0 if self.blocks is None or self.broken else self.blocks.waiting

    def block_announcement(self, side: Side, session: str) -> BlockAnnouncement:
        """The announcement as a message of its own, after the last step."""
        block, tag = self.announcement()
        return BlockAnnouncement(
            side=side, session=session, block=block, tag=tag, waiting=self.waiting
        )

    @property
    def began(self) -> bool:
        """Whether the transition counted last was the first one of a block."""
        return self.blocks is not None and self.blocks.began

    # --- the key maker's side ---------------------------------------------------------------------

    def tasks(self, judged: Iterable[BlockResult] = ()) -> tuple[Task, ...]:
        """Tasks for the key maker: write results down, store blocks."""
        blocks = self.blocks
        if blocks is None or self.broken:
            return ()
        tasks: list[Task] = [*judged]
        while (closed := blocks.to_keep()) is not None:
            tasks.append(closed)
        return tuple(tasks)

    def done(self, done: Done) -> tuple[Task, ...]:
        """Note a task that is done; returns the key maker's next tasks."""
        judged: tuple[BlockResult, ...] = ()
        if isinstance(done, Broken):
            self.broken = done.reason
        elif self.blocks is not None and isinstance(done, Stored):
            if done.session == self.blocks.session:
                self._became(done.number, _why_not(done))
            judged = self.blocks.stored(done)
        elif self.blocks is not None and isinstance(done, BlockResult):
            self.blocks.judged(done.session, done.number)
            if done.what == "unequal" and done.session == self.blocks.session:
                self._became(done.number, f"block {done.number} differs from the partner's")
                self._newest = inf  # nothing of this session is confirmed any more
            if done.what == "confirmed" and self.schedule is not None:
                self.made += done.keys
                self.last = (done.keys, self.schedule.length(done.number))
        return self.tasks(judged)

    def _became(self, number: int, why_not: str) -> None:
        """Note why a block of this session made no key. ``stopped`` is that of the newest block."""
        self.lost += bool(why_not)
        if number >= self._newest:
            self._newest, self.stopped = number, why_not

    def status_fields(self, refused: str) -> dict[str, Any]:
        """Fields of a status on keys; ``refused`` says why the store gives none."""
        return {
            "keys_made": self.made,
            "keys_of_block": self.last[0],
            "key_block_steps": self.last[1],
            "keys_refused": self.broken or refused,
            "keys_stopped": self.crowded or self.stopped,
            "key_blocks_lost": self.lost,
            "key_blocks_waiting": self.waiting,
            "appearances": self.appearances,
        }

    def new_rows(self) -> tuple[Contribution, ...]:
        """Rows that the journal must have with the next record; named once."""
        rows, self._rows = self._rows, ()
        return rows

    def obsolete_rows(self) -> tuple[range, ...]:
        """Transitions whose rows the journal may drop; named once."""
        return () if self.blocks is None else self.blocks.obsolete_rows()


def _why_not(block: Stored) -> str:
    """Why a block made no key."""
    if block.exhausted:
        return NO_PAD_LEFT
    if block.older:
        return f"block {block.number} began before the key store did"
    return "" if block.keys else f"block {block.number} lost too many copies to make one"
