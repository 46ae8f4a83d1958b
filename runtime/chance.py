"""What is drawn at random: by the operating system's generator in a service, by a seed elsewhere.

The protocol is handed all that is drawn (:mod:`protocol.streams`) and draws nothing itself.
"""

import os
import random
import secrets
from binascii import b2a_base64
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from protocol.secret.nonces import NONCE_BYTES, NonceSource
from protocol.streams import DISTURBANCE, SeededSymbols, Stream, SymbolSource

T = TypeVar("T")


class _Drawn(Generic[T]):
    """Items from the operating system's generator, many at a call, which costs 2 microseconds.

    Each is given once, also where threads ask at once; a process that was forked draws anew.
    """

    def __init__(self, draw: Callable[[], Iterable[T]]) -> None:
        self._draw = draw
        self._items: list[T] = []
        os.register_at_fork(after_in_child=self._items.clear)

    def next(self) -> T:
        """The next one."""
        while True:
            try:
                return self._items.pop()
            except IndexError:
                self._items.extend(self._draw())


def _nonces() -> Iterable[str]:
    drawn = os.urandom(64 * NONCE_BYTES)
    for i in range(0, len(drawn), NONCE_BYTES):
        yield b2a_base64(drawn[i : i + NONCE_BYTES], newline=False).decode()


_NONCES = _Drawn(_nonces)
_BYTES = _Drawn(lambda: os.urandom(64))


def fresh_nonce() -> str:
    """A nonce from the operating system's generator, in base64."""
    return _NONCES.next()


def seeded_nonces(seed: int, run: int) -> NonceSource:
    """Nonces that a seed gives again, for a simulated run: its ends draw from one source."""
    draw = random.Random(f"nonces {seed} {run}")
    return lambda: b2a_base64(draw.randbytes(NONCE_BYTES), newline=False).decode()


class SystemSymbols:
    """Symbols from the operating system's generator; the index is not used."""

    def symbol(self, transition: int, size: int) -> int:  # noqa: ARG002
        """A fresh uniform symbol in range(size)."""
        if 256 % size == 0:  # one byte is exactly uniform; randbelow draws until it has a fit
            return _BYTES.next() % size
        return secrets.randbelow(size)


def symbols(seed: int | None, stream: int) -> SymbolSource:
    """The system's symbols, or a seeded stream's where a seed is given."""
    return SystemSymbols() if seed is None else SeededSymbols(seed, stream)


def noise(seed: int | None, width: int) -> Stream:
    """Uniform numbers for the simulated disturbance; not secret, so a random seed will do."""
    return Stream(
        int.from_bytes(secrets.token_bytes(16)) if seed is None else seed, DISTURBANCE, width=width
    )
