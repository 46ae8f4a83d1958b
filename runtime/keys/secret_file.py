"""The file of the secret that the two ends share before their first key block."""

import os
import secrets
from pathlib import Path
from typing import Final

from protocol.secret.authentication import PADS_BYTES, SECRET_BYTES, Secret

_FORM: Final = "wyner-secret-2"
_USED: Final = "used"


class SecretError(Exception):
    """A file holds no secret, or one that was taken already. The text is one line."""


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
        raise SecretError(f"{path}: expected a secret as `wyner certs --secret` writes it")
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
    """Overwrite the secret by a line that says it was taken, so no second store uses its pads.

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
