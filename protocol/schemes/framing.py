"""Messages to symbols and back: start symbol, length, payload, CRC-32; idle symbols between frames.

The automata carry a stream of symbols in range(M). While nothing is queued the stream is idle (0).
A frame is the start symbol 1 and then bytes: length (2, big-endian), payload, CRC-32 of both (4,
big-endian). A byte is the fixed number of base-M digits that hold it, most significant first; for
M = 2 its eight bits. The format is public, as everything but the keys is.
"""

import zlib
from typing import Final, NamedTuple

IDLE: Final = 0
START: Final = 1
LENGTH_BYTES: Final = 2
CHECK_BYTES: Final = 4
MAX_PAYLOAD: Final = 2 ** (8 * LENGTH_BYTES) - 1


def digits_per_byte(size: int) -> int:
    """The number of base-``size`` digits that hold a byte: 8 for 2, 6 for 3, 4 for 4."""
    digits = 1
    while size**digits < 256:
        digits += 1
    return digits


def frame_length(payload_bytes: int, size: int) -> int:
    """Symbols in the frame of a payload of ``payload_bytes`` bytes."""
    return 1 + (LENGTH_BYTES + payload_bytes + CHECK_BYTES) * digits_per_byte(size)


def encode_frame(payload: bytes, size: int) -> bytes:
    """The frame of ``payload`` as symbols, one a byte of the result.

    Raises
    ------
    ValueError
        When the payload is longer than :data:`MAX_PAYLOAD` bytes.
    """
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(
            f"message: got {len(payload)} bytes, expected at most {MAX_PAYLOAD} in one message"
        )
    body = len(payload).to_bytes(LENGTH_BYTES, "big") + payload
    body += zlib.crc32(body).to_bytes(CHECK_BYTES, "big")
    places = range(digits_per_byte(size) - 1, -1, -1)
    return bytes((START, *(byte // size**place % size for byte in body for place in places)))


class Frame(NamedTuple):
    """The end of a frame: its payload, and whether the check held."""

    payload: bytes
    intact: bool


class Deframer:
    """Takes message symbols one at a time and gives back whole frames.

    The symbols of the frame under way are kept (`symbols`), so that it can be rebuilt after a
    restart by pushing them again.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.symbols = bytearray()
        self._bytes = bytearray()
        self._digits = digits_per_byte(size)
        self._value = 0
        self._count = 0

    @property
    def expected_length(self) -> int:
        """Symbols in the frame under way; 0 until its length is known."""
        if len(self._bytes) < LENGTH_BYTES:
            return 0
        return frame_length(self._payload_length(), self.size)

    @property
    def partial(self) -> bytes:
        """The payload bytes of the frame under way that are known so far."""
        if len(self._bytes) <= LENGTH_BYTES:
            return b""
        return bytes(self._bytes[LENGTH_BYTES : LENGTH_BYTES + self._payload_length()])

    def _payload_length(self) -> int:
        return int.from_bytes(self._bytes[:LENGTH_BYTES], "big")

    def push(self, symbol: int) -> Frame | None:
        """Take the next message symbol; a frame when this one completed it.

        Outside a frame anything but the start symbol is idle. A byte whose digits exceed 255
        (possible where M is no power of two) refuses the frame.
        """
        if not self.symbols:
            if symbol == START:
                self.symbols.append(symbol)
            return None
        self.symbols.append(symbol)
        self._value = self._value * self.size + symbol
        self._count += 1
        if self._count < self._digits:
            return None
        if self._value > 255:
            self.reset()
            return Frame(b"", False)
        self._bytes.append(self._value)
        self._value = 0
        self._count = 0
        if len(self._bytes) < LENGTH_BYTES:
            return None
        if len(self._bytes) < LENGTH_BYTES + self._payload_length() + CHECK_BYTES:
            return None
        body, check = self._bytes[:-CHECK_BYTES], self._bytes[-CHECK_BYTES:]
        frame = Frame(bytes(body[LENGTH_BYTES:]), zlib.crc32(body) == int.from_bytes(check, "big"))
        self.reset()
        return frame

    def reset(self) -> None:
        """Forget the frame under way."""
        self.symbols = bytearray()
        self._bytes = bytearray()
        self._value = 0
        self._count = 0


def readable(payload: bytes) -> str:
    """A payload as one line of text for people: undecodable and unprintable characters as ``·``."""
    text = payload.decode("utf-8", errors="replace").replace("\ufffd", "·")
    return "".join(c if c.isprintable() else "·" for c in text)
