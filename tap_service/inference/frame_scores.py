"""How plausible message symbols are as frames, scored as they come, for many hypotheses at once.

Each is scored as the log ratio of its symbols as a message (idle symbols, frames with a likely
length, text, a check that holds) over random symbols.
"""

import zlib
from typing import Final

import numpy as np

from protocol.arrays import Flags, Indices
from protocol.schemes.framing import CHECK_BYTES, LENGTH_BYTES, START, block_bytes, digits_of
from tap_service.inference.counts import OTHER, class_of
from tap_service.inference.english import plausibility
from tap_service.inference.hypotheses import Hypotheses
from tap_service.inference.symbol_paths import SymbolPaths

IDLE_SHARE: Final = 0.97
"""Probability of an idle symbol outside a frame; the rest is the start symbol's."""

SHORT_SHARE: Final = 0.9
"""Probability of a message shorter than 256 bytes."""

SURE: Final = 14.0
"""Log ratio that a frame check itself must have earned. A check heard whole earns 22; with guesses
in it, one of the thousands of payloads on the list may fit by chance, and is not believed."""

REFUSED: Final = -25.0
"""Score of a frame whose check does not hold: no end ever sends one."""

_ONES: Final = 0xFFFFFFFF
_CRC: Final = np.array(
    # the public table of CRC-32, from the library's own function on single bytes
    [zlib.crc32(bytes([i]), _ONES) ^ _ONES for i in range(256)], dtype=np.intp
)  # fmt: skip


class FrameScores:
    """Reads the symbols of hypotheses as frames.

    Parameters
    ----------
    hypotheses : Hypotheses
        Whose columns of the frame and the score it keeps.
    paths : SymbolPaths
        The same hypotheses' symbols.
    size : int
        M.
    framed : bool
        Whether messages come in frames; otherwise symbols are raw bytes of text from the start.

    Attributes
    ----------
    held : bool
        Whether a frame check has held since this was last cleared.
    """

    def __init__(
        self, hypotheses: Hypotheses, paths: SymbolPaths, size: int, *, framed: bool
    ) -> None:
        self._hypotheses, self._paths = hypotheses, paths
        self._size, self._framed = size, framed
        self.held = False
        self._digits = digits_of(1, size)
        self._powers = size ** np.arange(self._digits)
        # Where the digits of a byte hold nothing else, every digit is judged as it comes; a block
        # of several bytes only when it is whole.
        self._block = block_bytes(size) if framed else 1
        longest = max(self._block, LENGTH_BYTES)
        self._block_digits = np.array([0, *(digits_of(n, size) for n in range(1, longest + 1))])
        self._ratios = plausibility()
        share = np.full(size, 1e-6)
        share[0], share[START] = IDLE_SHARE, 1 - IDLE_SHARE
        self._idle_scores = np.log(size * share)

    def begin(self, which: "Indices | slice[int, int, None]") -> None:
        """No frame is under way in these."""
        h = self._hypotheses
        for column in (h.count, h.value, h.bytes):
            column[which] = 0
        h.phase[which] = 0 if self._framed else 1
        h.length[which] = -1
        h.crc[which] = _ONES
        h.before[which] = h.last[which] = OTHER

    def push(self, which: Indices, values: Indices) -> None:
        """Score the next symbol of each, which already stands at the end of its path."""
        h = self._hypotheses
        idle = h.phase[which] == 0
        if idle.any():
            outside, symbols = which[idle], values[idle]
            h.score[outside] += self._idle_scores[symbols]
            h.phase[outside[symbols == START]] = 1
            which, values = which[~idle], values[~idle]
            if not len(which):
                return
        if self._block > 1:
            self._push_block(which)
            return
        if self._framed:
            which, values = self._check_digits(which, values)
        h.value[which] = h.value[which] * self._size + values
        h.count[which] += 1
        full = which[h.count[which] == self._digits]
        if len(full):
            self._push_bytes(full)

    def _push_bytes(self, which: Indices) -> None:
        h = self._hypotheses
        values = h.value[which]
        h.value[which] = 0
        h.count[which] = 0
        excess = values > 255
        if excess.any():
            self._refuse(which[excess])
            which, values = which[~excess], values[~excess]
        self._take(which, values)

    def _push_block(self, which: Indices) -> None:
        """Count a digit of a block of bytes; where it was the last, take the bytes in turn."""
        h = self._hypotheses
        h.count[which] += 1
        position = h.bytes[which]
        left = LENGTH_BYTES + h.length[which] + CHECK_BYTES - position
        size = np.where(position == 0, LENGTH_BYTES, np.minimum(left, self._block))
        digits = self._block_digits[size]
        full = h.count[which] == digits
        for count in np.unique(size[full]).tolist():
            group = which[full & (size == count)]
            numbers = [
                self._paths.number(int(node), int(digits_of(count, self._size)))
                for node in h.node[group]
            ]
            h.count[group] = 0
            fits = np.array([number < 256**count for number in numbers])
            self._refuse(group[~fits])
            group = group[fits]
            whole = [n.to_bytes(count, "big") for n in numbers if n < 256**count]
            table_of_bytes = np.frombuffer(b"".join(whole), dtype=np.uint8).reshape(-1, count)
            for place in range(count):
                going = h.phase[group] == 1
                group, table_of_bytes = group[going], table_of_bytes[going]
                if not len(group):
                    break
                right = self._check_bytes(group, table_of_bytes[:, place].astype(np.intp))
                group, table_of_bytes = group[right], table_of_bytes[right]
                self._take(group, table_of_bytes[:, place].astype(np.intp))

    def _check_bytes(self, which: Indices, values: Indices) -> Flags:
        """Compare bytes of a frame's check with what they must be; refuse the wrong ones."""
        h = self._hypotheses
        place = h.bytes[which] - LENGTH_BYTES - h.length[which]
        tail = (h.bytes[which] >= LENGTH_BYTES) & (place >= 0)
        shift = 8 * np.clip(CHECK_BYTES - 1 - place, 0, CHECK_BYTES - 1)
        byte = (h.crc[which] ^ _ONES) >> shift & 0xFF
        begun = which[tail & (place == 0)]
        h.mark[begun] = h.score[begun]
        right: Flags = ~tail | (byte == values)
        h.score[which[tail & right]] += np.log(256)
        self._refuse(which[~right])
        return right

    def _check_digits(self, which: Indices, values: Indices) -> tuple[Indices, Indices]:
        """Compare each digit of a frame's check with what it must be; refuse at the first wrong."""
        h = self._hypotheses
        place = h.bytes[which] - LENGTH_BYTES - h.length[which]
        tail = (h.bytes[which] >= LENGTH_BYTES) & (place >= 0)
        if not tail.any():
            return which, values
        checked = which[tail]
        byte = (h.crc[checked] ^ _ONES) >> 8 * (CHECK_BYTES - 1 - place[tail]) & 0xFF
        digit = byte // self._powers[self._digits - 1 - h.count[checked]] % self._size
        begun = checked[(place[tail] == 0) & (h.count[checked] == 0)]
        h.mark[begun] = h.score[begun]
        right = digit == values[tail]
        h.score[checked[right]] += np.log(self._size)
        self._refuse(checked[~right])
        going = np.ones(len(which), dtype=bool)
        going[np.flatnonzero(tail)[~right]] = False
        return which[going], values[going]

    def _take(self, which: Indices, values: Indices) -> None:
        """The next byte of each."""
        h = self._hypotheses
        position = h.bytes[which]
        h.bytes[which] += 1
        if not self._framed:
            self._text(which, values)
            return
        length = h.length[which]
        head = position < LENGTH_BYTES
        tail = ~head & (position >= LENGTH_BYTES + length)
        fed = which[~tail]
        crc = h.crc[fed]
        h.crc[fed] = _CRC[(crc ^ values[~tail]) & 0xFF] ^ (crc >> 8)
        if head.any():
            self._head(which[head], position[head], values[head])
        body = ~head & ~tail
        if body.any():
            self._text(which[body], values[body])
        over = tail & (position == LENGTH_BYTES + length + CHECK_BYTES - 1)
        if over.any():
            self._hold(which[over])

    def _head(self, which: Indices, position: Indices, values: Indices) -> None:
        h = self._hypotheses
        high = position == 0
        first, rest = which[high], which[~high]
        h.length[first] = values[high] << 8
        h.score[first] += np.where(
            values[high] == 0, np.log(256 * SHORT_SHARE), np.log(256 * (1 - SHORT_SHARE) / 255)
        )
        h.length[rest] |= values[~high]
        empty = rest[h.length[rest] == 0]
        self._refuse(empty)

    def _text(self, which: Indices, values: Indices) -> None:
        h = self._hypotheses
        classes = class_of(values)
        h.score[which] += self._ratios[h.before[which], h.last[which], classes]
        h.before[which] = h.last[which]
        h.last[which] = classes

    def _refuse(self, which: Indices) -> None:
        if len(which):
            self._hypotheses.score[which] += REFUSED
            self.begin(which)

    def _hold(self, which: Indices) -> None:
        """A frame check held: that is the message, unless too much of the check was guessed."""
        h = self._hypotheses
        h.passed[which] += h.score[which] - h.mark[which] >= SURE
        self.begin(which)
        self.held = True
