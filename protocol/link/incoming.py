"""The plant's end of the frames: message symbols come in, whole messages come out."""

from typing import Final, NamedTuple

from protocol.link.records import IncomingRecord
from protocol.schemes.framing import Deframer

SYMBOLS_AT_ONCE: Final = 64
"""Symbols of the frame under way that the record holds; then they go to a table of the journal.
A frame may have half a million symbols, and the record is written in every step."""


def hex_digits(size: int) -> int:
    """Hexadecimal digits of a symbol in the record: one up to M = 16, else two."""
    return 1 if size <= 16 else 2


class Taken(NamedTuple):
    """What came of a message symbol.

    ``symbols`` have left the record. ``payload`` is that of a frame that is whole; ``refused``: it
    failed its check.
    """

    symbols: str = ""
    payload: bytes | None = None
    refused: bool = False

    @property
    def ended(self) -> bool:
        """Whether a frame is over."""
        return self.refused or self.payload is not None


NOTHING_TAKEN: Final = Taken()
"""Where a transition carried no message symbol."""


class Incoming:
    """The frame under way.

    Parameters
    ----------
    size : int
        M.
    record : IncomingRecord
    stored : str
        Its symbols that stand in the journal's table.
    """

    def __init__(self, size: int, record: IncomingRecord, stored: str = "") -> None:
        self.record = record
        self.deframer = Deframer(size)
        self._digits = hex_digits(size)
        symbols = stored + record.partial
        for i in range(0, len(symbols), self._digits):
            self.deframer.push(int(symbols[i : i + self._digits], 16))

    def take(self, symbol: int) -> Taken:
        """Take a message symbol."""
        deframer, record, symbols = self.deframer, self.record, ""
        before = deframer.refused
        payload = deframer.push(symbol)
        refused = deframer.refused > before
        partial, stored = f"{record.partial}{symbol:0{self._digits}x}", record.stored
        if len(partial) >= SYMBOLS_AT_ONCE * self._digits:
            partial, symbols = "", partial
            stored += len(symbols)
        if not deframer.symbols:
            partial, symbols, stored = "", "", 0
        self.record = IncomingRecord(
            partial, stored, record.messages + (payload is not None), record.refused + refused
        )
        return Taken(symbols, payload, refused)

    def reset(self) -> None:
        """Forget the frame under way."""
        self.deframer.reset()
        self.record = self.record._replace(partial="", stored=0)
