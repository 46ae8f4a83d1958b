"""The steps of a journal since its last rare write: one write to a file each, checked when read.

An entry begins with the journal's own tag and has a number that goes up by one, and a CRC-32. A
process that is killed leaves whole steps and at most one torn one, the last, which is cut off.
"""

import errno
import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple
from zlib import crc32

from protocol.agreement import NO_SYMBOL
from protocol.messages import Measurement, Offer
from protocol.secret.nonces import Contribution
from runtime.files import open_private

TAG_BYTES: Final = 8
"""Length of a journal's random tag: what another journal wrote is not taken for its own."""

STEPS: Final = "-steps"
"""What the file is called, after its journal's name."""

LARGEST_STEP: Final = 1 << 20
"""Bytes of steps after which the journal's next write should be a rare one."""

READY: Final = bytes(1 << 16)
"""What is written ahead of the steps: zeros, which are no step."""

_CHECK: Final = struct.Struct("<I")
_HEAD: Final = struct.Struct("<QhIII?QIBB")
"""number, coin; lengths of record, offer, measurement; whether there is a row, its j, its steps and
the lengths of its two nonces."""

_HEAD_AT: Final = TAG_BYTES + _CHECK.size


class Damaged(Exception):
    """A step is damaged and whole steps follow it; the text says at which byte."""


class Entry(NamedTuple):
    """One write, as it is read back: a record, the step after it (or none), a key block's row.

    ``offer`` and ``measurement`` are messages as they travelled.
    """

    number: int
    record: bytes
    offer: bytes = b""
    measurement: bytes = b""
    coin: int = NO_SYMBOL
    row: Contribution | None = None

    @property
    def begun(self) -> bool:
        """Whether the step after the record is under way, with no measurement yet."""
        return bool(self.offer) and not self.measurement


class StepLog:
    """The file of steps of one journal.

    Parameters
    ----------
    path : Path
        Made where it is missing.
    tag : bytes
        The journal's own, `TAG_BYTES` long.

    Attributes
    ----------
    size : int
        Bytes of whole steps.

    Raises
    ------
    OSError
        Here and on writing, when something cannot be written whole or is no regular file.
    """

    def __init__(self, path: Path, tag: bytes) -> None:
        self._path = path
        self._tag = tag
        self._file = open_private(path, os.O_RDWR | os.O_CREAT)
        self.size = self._ready = 0

    def read(self, after: int) -> list[Entry]:
        """The whole steps that follow write ``after``, in order; all else goes.

        That is a torn step, steps that a rare write has made superfluous, and steps that do not
        follow because the write between is missing, as it may be after a power failure.

        Raises
        ------
        Damaged
            When whole steps lie behind what is none.
        """
        data = os.pread(self._file, os.fstat(self._file).st_size, 0)
        steps: list[Entry] = []
        end = 0
        while (found := self._whole(data, end)) is not None:
            if steps and found[0].number != steps[-1].number + 1:
                break
            steps.append(found[0])
            end = found[1]
        behind = end
        while (behind := data.find(self._tag, behind + 1)) >= 0:
            found = self._whole(data, behind)
            if found is not None and found[0].number > after:
                raise Damaged(f"byte {end}: not a step, but whole steps follow it")
        if not steps or not steps[0].number <= after + 1 <= steps[-1].number:
            steps, end = [], 0
        if end < len(data):
            os.ftruncate(self._file, end)
        self.size = self._ready = end
        return [step for step in steps if step.number > after]

    def _whole(self, data: bytes, at: int) -> tuple[Entry, int] | None:
        """The step that begins at ``at`` and where it ends; None where it is not whole."""
        place = at + _HEAD_AT + _HEAD.size
        if not data.startswith(self._tag, at) or place > len(data):
            return None
        head = _HEAD.unpack_from(data, at + _HEAD_AT)
        number, coin, *lengths, has_row, j, steps, first, second = head
        parts: list[bytes] = []
        for length in (*lengths, first, second):
            parts.append(data[place : place + length])
            place += length
        check = _CHECK.unpack_from(data, at + TAG_BYTES)[0]
        if place > len(data) or crc32(data[at + _HEAD_AT : place]) != check:
            return None
        record, offer, measurement, *nonces = parts
        row = Contribution(j, steps, nonces[0] or None, nonces[1] or None) if has_row else None
        return Entry(number, record, offer, measurement, coin, row), place

    def append(
        self,
        number: int,
        record: bytes,
        offer: Offer | None = None,
        coin: int = NO_SYMBOL,
        measurement: Measurement | None = None,
        row: Contribution | None = None,
    ) -> None:
        """Write one more entry; on return it survives the death of this process."""
        offered = b"" if offer is None else offer.wire()
        measured = b"" if measurement is None else measurement.wire()
        j, steps, *nonces = row or (0, 0, None, None)
        first, second = (nonce or b"" for nonce in nonces)
        head = _HEAD.pack(
            number,
            coin,
            len(record),
            len(offered),
            len(measured),
            row is not None,
            j,
            steps,
            len(first),
            len(second),
        )
        body = b"".join((head, record, offered, measured, first, second))
        data = self._tag + _CHECK.pack(crc32(body)) + body
        self._write(data, self.size)
        self.size += len(data)

    def _write(self, data: bytes, at: int) -> None:
        if os.pwrite(self._file, data, at) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._path))

    def make_ready(self) -> None:
        """Write zeros ahead of the steps, when nobody waits: no step then begins a new page.

        A write that begins a page takes 1 us longer. Of steps of 1024 bytes every fourth one would,
        always in the same automaton state, which a tap could see.
        """
        if self._ready - self.size < len(READY) // 4:
            start = max(self.size, self._ready)
            with suppress(OSError):  # where there is no room left, a step will say so
                self._ready = start + os.pwrite(self._file, READY, start)

    def clear(self) -> None:
        """Forget all steps: a rare write has what they came to.

        Zeros take their place. To cut the file would give back its blocks, and a file system that
        tells its disk of each ("discard") lets the loop wait for that: 15 ms for 1 MiB.
        """
        self._write(bytes(self.size), 0)
        self._ready = max(self._ready, self.size)
        self.size = 0

    def close(self) -> None:
        """Close the file; what was made ready goes."""
        with suppress(OSError):
            if self.size < self._ready:
                os.ftruncate(self._file, self.size)
        os.close(self._file)
