"""One-time tags: a polynomial modulo 2^127 - 1 at a secret point, under a pad used once.

A message of w words is forged with probability (w + 1) / (2^127 - 1) at most, whatever the forger
can compute (Wegman and Carter 1981; den Boer 1993). The point may stay, the pad may not. Two tags
whose pads and texts are known are two equations for one point, so it does not stay for long either:
:mod:`protocol.secret.ledger` renews it.
"""

import os
import secrets
from pathlib import Path
from typing import Final, NamedTuple

PRIME: Final = 2**127 - 1
TAG_BYTES: Final = 16
WORD_BYTES: Final = 15
"""A word is below 2^120 and so below the prime, whatever its bytes are."""

RESERVE: Final = 16
"""Sets of pads in a first secret: each session takes one for its first key block."""

PADS_BYTES: Final = 3 * TAG_BYTES
"""A set: the point, the pad of the controller's tag, that of the plant's."""

SECRET_BYTES: Final = RESERVE * PADS_BYTES


def polynomial(point: int, data: bytes) -> int:
    """The words of ``data`` and its length as coefficients, evaluated at ``point``.

    w_1 z^(m+1) + ... + w_m z^2 + length z modulo 2^127 - 1: no two texts share their coefficients,
    and no constant term remains that a forger could move along with the pad.
    """
    total = 0
    for start in range(0, len(data), WORD_BYTES):
        total = (total + int.from_bytes(data[start : start + WORD_BYTES])) * point % PRIME
    return (total + len(data)) * point % PRIME


def number(raw: bytes) -> int:
    """16 uniform bytes as a number modulo the prime: the top bit is left out."""
    return int.from_bytes(raw) & PRIME


def under(pad: int, value: int) -> str:
    """A polynomial's value under its pad: the tag, 32 hexadecimal digits."""
    return f"{(value + pad) % PRIME:032x}"


def tag(point: int, pad: int, data: bytes) -> str:
    """The tag of ``data``."""
    return under(pad, polynomial(point, data))


class Secret(NamedTuple):
    """What the two ends share before the first block: sets of pads.

    ``name`` says in logs and ledgers which secret it is; it is public and random.
    """

    name: str
    sets: tuple[bytes, ...]


_FORM: Final = "wyner-secret-2"
_USED: Final = "used"


class SecretError(Exception):
    """A file that holds no secret, or one that was taken already; the text is one line."""


def make_secret(path: Path) -> str:
    """Write a new secret to ``path``, readable by its owner only; returns its name.

    Raises
    ------
    SecretError
        When the file is there already, or cannot be written.
    """
    name = secrets.token_hex(4)
    text = f"{_FORM} {name} {secrets.token_hex(SECRET_BYTES)}\n"
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        raise SecretError(f"{path}: is there already; a secret is never written over") from None
    except OSError as error:
        raise SecretError(f"{path}: cannot be written: {error.strerror}") from None
    return name


def read_secret(path: Path) -> Secret | str:
    """The secret in ``path``, or the name of one that was taken from it before.

    Raises
    ------
    SecretError
        When the file cannot be read, is open to others, or holds something else.
    """
    try:
        mode = path.stat().st_mode
        parts = path.read_text("ascii").split()
    except OSError as error:
        raise SecretError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        parts = []
    if len(parts) != 3 or parts[0] != _FORM:
        raise SecretError(f"{path}: expected a secret as `wyner secret` writes it")
    if mode & 0o077:
        raise SecretError(f"{path}: got mode {mode & 0o777:o}, expected 600: others may read it")
    name, body = parts[1:]
    if body == _USED:
        return name
    try:
        raw = bytes.fromhex(body)
    except ValueError:
        raw = b""
    if len(raw) != SECRET_BYTES:
        raise SecretError(f"{path}: expected {2 * SECRET_BYTES} hexadecimal digits")
    starts = range(0, len(raw), PADS_BYTES)
    return Secret(name, tuple(raw[start : start + PADS_BYTES] for start in starts))


def spend_secret(path: Path, name: str) -> None:
    """Replace the secret by a line that says it was taken: a second store must not reuse its pads.

    Raises
    ------
    SecretError
        When the file cannot be rewritten.
    """
    try:
        with path.open("r+b") as file:
            size = len(file.read())
            line = f"{_FORM} {name} {_USED}\n".encode()
            file.seek(0)
            file.write(line + b"\0" * (size - len(line)))
            file.flush()
            os.fsync(file.fileno())
            file.truncate(len(line))
    except OSError as error:
        raise SecretError(
            f"{path}: cannot be marked as used ({error.strerror}): a secret serves one store once"
        ) from None
