"""Messages to symbols and back: start symbol, length, payload, CRC-32; idle symbols between frames.

The automata carry a stream of symbols in range(M). While nothing is queued the stream is idle (0).
A frame is the start symbol 1 and then bytes: length (2, big-endian), payload, CRC-32 of both (4,
big-endian). The length is one block; what follows is cut into blocks of :func:`block_bytes` bytes,
of which the last one may be shorter. A block is one number, in as few base-M digits as hold it,
most significant first: for M = 2 eight bits a byte, for M = 3 eleven bytes in 56 digits. So no M
wastes more than one digit in a hundred. The format is public, as everything but the keys is.
"""

import math
import zlib
from collections.abc import Iterator
from functools import cache
from itertools import repeat
from typing import Final

IDLE: Final = 0
START: Final = 1
LENGTH_BYTES: Final = 2
CHECK_BYTES: Final = 4
MAX_PAYLOAD: Final = 2 ** (8 * LENGTH_BYTES) - 1
WASTE: Final = 0.01


@cache
def digits_of(count: int, size: int) -> int:
    """The fewest base-``size`` digits that hold ``count`` bytes: of one, 8 for 2 and 6 for 3."""
    digits = max(1, math.floor(8 * count / math.log2(size)) - 1)
    while size**digits < 256**count:
        digits += 1
    return digits


@cache
def block_bytes(size: int) -> int:
    """Bytes in a block: the fewest of which the digits hold at most 1 % more than the bytes."""
    count = 1
    while 8 * count < (1 - WASTE) * digits_of(count, size) * math.log2(size):
        count += 1
    return count


def blocks(body_bytes: int, size: int) -> Iterator[int]:
    """Bytes of each block of a frame whose payload and check are ``body_bytes`` long."""
    yield LENGTH_BYTES
    whole, rest = divmod(body_bytes, block_bytes(size))
    yield from repeat(block_bytes(size), whole)
    if rest:
        yield rest


def frame_length(payload_bytes: int, size: int) -> int:
    """Symbols in the frame of a payload of ``payload_bytes`` bytes."""
    body, count = payload_bytes + CHECK_BYTES, block_bytes(size)
    whole, rest = divmod(body, count)
    symbols = 1 + digits_of(LENGTH_BYTES, size) + whole * digits_of(count, size)
    return symbols + (digits_of(rest, size) if rest else 0)


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
    out, place = bytearray((START,)), 0
    for count in blocks(len(payload) + CHECK_BYTES, size):
        value = int.from_bytes(body[place : place + count], "big")
        digits = bytearray(digits_of(count, size))
        for i in reversed(range(len(digits))):
            value, digits[i] = divmod(value, size)
        out += digits
        place += count
    return bytes(out)


class Deframer:
    """Takes message symbols one at a time and gives back whole frames.

    The symbols of the frame under way are kept (`symbols`), so that it can be rebuilt after a
    restart by pushing them again. ``refused`` counts frames that failed their check.
    ``ended`` is the payload of the frame that ended last, whether its check held or not.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.symbols = bytearray()
        self.refused = 0
        self.ended = b""
        self._bytes = bytearray()
        self._block = LENGTH_BYTES
        self._digits = digits_of(LENGTH_BYTES, size)
        self._value = 0
        self._count = 0

    @property
    def expected_length(self) -> int:
        """Symbols in the frame under way; 0 until its length is known."""
        if len(self._bytes) < LENGTH_BYTES:
            return 0
        return frame_length(self._payload_length(), self.size)

    @property
    def lacks_one(self) -> bool:
        """Whether the next symbol is the last one of the frame under way."""
        ends_block = self._count + 1 == self._digits
        return ends_block and len(self.symbols) + 1 == self.expected_length

    @property
    def partial(self) -> bytes:
        """The payload bytes of the frame under way that are known so far."""
        if len(self._bytes) <= LENGTH_BYTES:
            return b""
        return bytes(self._bytes[LENGTH_BYTES : LENGTH_BYTES + self._payload_length()])

    def _payload_length(self) -> int:
        return int.from_bytes(self._bytes[:LENGTH_BYTES], "big")

    def push(self, symbol: int) -> bytes | None:
        """Take the next message symbol; the payload, where this one completed an intact frame.

        Outside a frame anything but the start symbol is idle. A block whose digits exceed its bytes
        (possible where M is no power of two) refuses the frame. A symbol may be of numpy's kind.
        """
        symbol = int(symbol)
        if not self.symbols:
            if symbol == START:
                self.symbols.append(symbol)
            return None
        self.symbols.append(symbol)
        self._value = self._value * self.size + symbol
        self._count += 1
        if self._count < self._digits:
            return None
        if self._value >= 256**self._block:
            self.reset()
            self.refused += 1
            self.ended = b""
            return None
        self._bytes += self._value.to_bytes(self._block, "big")
        missing = LENGTH_BYTES + self._payload_length() + CHECK_BYTES - len(self._bytes)
        if missing:
            self._begin(min(missing, block_bytes(self.size)))
            return None
        body, check = self._bytes[:-CHECK_BYTES], self._bytes[-CHECK_BYTES:]
        self.reset()
        self.ended = bytes(body[LENGTH_BYTES:])
        if zlib.crc32(body) != int.from_bytes(check, "big"):
            self.refused += 1
            return None
        return self.ended

    def _begin(self, block: int) -> None:
        self._block, self._digits = block, digits_of(block, self.size)
        self._value = self._count = 0

    def reset(self) -> None:
        """Forget the frame under way."""
        self.symbols = bytearray()
        self._bytes = bytearray()
        self._begin(LENGTH_BYTES)
