"""The plant's end of the frames: message symbols come in, whole messages come out."""

from typing import Final, NamedTuple

from protocol.schemes.framing import Deframer

SYMBOLS_AT_ONCE: Final = 64
"""Symbols of the frame under way that the record holds; then they go to a table of the journal.
A frame may have half a million symbols, and the record is written in every step."""


def hex_digits(size: int) -> int:
    """Hexadecimal digits of a symbol in the record: one up to M = 16, else two."""
    return 1 if size <= 16 else 2


class Taken(NamedTuple):
    """What came of a message symbol.

    ``partial`` and ``stored`` are for the record, ``symbols`` have left it. ``payload`` is that of
    a frame that is whole; ``refused``: it failed its check.
    """

    partial: str
    stored: int
    symbols: str = ""
    payload: bytes | None = None
    refused: bool = False

    @property
    def ended(self) -> bool:
        """Whether a frame is over."""
        return self.refused or self.payload is not None


class Incoming:
    """The frame under way.

    Parameters
    ----------
    size : int
        M.
    kept : str
        Its symbols, as they were read back.
    """

    def __init__(self, size: int, kept: str) -> None:
        self.deframer = Deframer(size)
        self._digits = hex_digits(size)
        for i in range(0, len(kept), self._digits):
            self.deframer.push(int(kept[i : i + self._digits], 16))
        self.lacks_one = self.deframer.lacks_one
        """Whether the next symbol is the frame's last; known before a step hangs on it."""

    def take(self, symbol: int, partial: str, stored: int) -> Taken:
        """Take a message symbol, where the record has ``partial`` and ``stored``."""
        deframer, symbols = self.deframer, ""
        refused = deframer.refused
        payload = deframer.push(symbol)
        self.lacks_one = deframer.lacks_one
        partial = f"{partial}{symbol:0{self._digits}x}"
        if len(partial) >= SYMBOLS_AT_ONCE * self._digits:
            partial, symbols = "", partial
            stored += len(symbols)
        if not deframer.symbols:
            partial, symbols, stored = "", "", 0
        return Taken(partial, stored, symbols, payload, deframer.refused > refused)

    def reset(self) -> None:
        """Forget the frame under way."""
        self.deframer.reset()
        self.lacks_one = False
