"""What is drawn at random: by the operating system's generator in a service, by a seed elsewhere.

The protocol is handed all that is drawn (:mod:`protocol.streams`) and draws nothing itself.
"""

import os
import random
import secrets
from binascii import b2a_base64

from protocol.secret.nonces import NONCE_BYTES, NonceSource
from protocol.streams import DISTURBANCE, SeededSymbols, Stream, SymbolSource


def new_id() -> str:
    """A random id of 64 bits, as 16 hexadecimal digits."""
    return os.urandom(8).hex()


def fresh_nonce() -> str:
    """A nonce from the operating system's generator, in base64."""
    return b2a_base64(os.urandom(NONCE_BYTES), newline=False).decode()


def seeded_nonces(seed: int, run: int) -> NonceSource:
    """Nonces that a seed gives again, for a simulated run: its ends draw from one source."""
    draw = random.Random(f"nonces {seed} {run}")
    return lambda: b2a_base64(draw.randbytes(NONCE_BYTES), newline=False).decode()


class SystemSymbols:
    """Symbols from the operating system's generator; the index is not used."""

    def symbol(self, transition: int, size: int) -> int:  # noqa: ARG002
        """A fresh uniform symbol in range(size)."""
        return secrets.randbelow(size)


def symbols(seed: int | None, stream: int) -> SymbolSource:
    """The system's symbols, or a seeded stream's where a seed is given."""
    return SystemSymbols() if seed is None else SeededSymbols(seed, stream)


def noise(seed: int | None, width: int) -> Stream:
    """Uniform numbers for the simulated disturbance; not secret, so a random seed will do."""
    return Stream(
        int.from_bytes(secrets.token_bytes(16)) if seed is None else seed, DISTURBANCE, width=width
    )
