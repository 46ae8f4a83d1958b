"""A sealed message: one-time pad and one-time tag under distilled keys, of any length.

"The old mill, at nine." is 22 bytes: 176 bits of pad and 256 bits for the tag, two keys of 256
bits. Whoever lacks the keys learns its length and no more. A forger changes it unseen with
probability (words + 1) / (2^127 - 1) at most. Both hold against any computing power. A key serves
one message.
"""

import hmac
from collections.abc import Sequence
from typing import Final

from protocol.secret.authentication import TAG_BYTES, number
from protocol.secret.authentication import tag as one_time_tag
from protocol.secret.nonces import NONCE_BYTES

TAG_KEY_BYTES: Final = 2 * TAG_BYTES


class Unsealed(ValueError):
    """A sealed message was changed on its way, or is under other keys. Its text is not returned."""


def keys_needed(length: int) -> int:
    """Number of 256-bit keys that a text of ``length`` bytes takes."""
    return -(-(length + TAG_KEY_BYTES) // NONCE_BYTES)


def seal(header: bytes, text: bytes, keys: Sequence[bytes]) -> tuple[bytes, str]:
    """Encrypt ``text`` and tag it together with ``header``, which travels in the clear.

    Parameters
    ----------
    header : bytes
        The message's id and key ids, in one encoding that both ends make alike.
    text : bytes
        Of any length.
    keys : sequence of bytes
        :func:`keys_needed` of them, never used before or after.

    Returns
    -------
    tuple of bytes and str
        The ciphertext, as long as the text, and its tag, 32 hexadecimal digits.
    """
    tag_key, pad = _split(keys, len(text))
    cipher = bytes(a ^ b for a, b in zip(text, pad, strict=True))
    return cipher, _tag(tag_key, header, cipher)


def unseal(header: bytes, cipher: bytes, tag: str, keys: Sequence[bytes]) -> bytes:
    """The text of a sealed message.

    Raises
    ------
    Unsealed
        When a bit of header, ciphertext or tag is not as it was sealed.
    """
    tag_key, pad = _split(keys, len(cipher))
    if not hmac.compare_digest(tag.encode(), _tag(tag_key, header, cipher).encode()):
        raise Unsealed("sealed message: its tag does not hold; it was changed on its way")
    return bytes(a ^ b for a, b in zip(cipher, pad, strict=True))


def _split(keys: Sequence[bytes], length: int) -> tuple[bytes, bytes]:
    if len(keys) != keys_needed(length):
        raise ValueError(f"keys: got {len(keys)}, expected {keys_needed(length)}")
    stream = b"".join(keys)
    return stream[:TAG_KEY_BYTES], stream[TAG_KEY_BYTES : TAG_KEY_BYTES + length]


def _tag(tag_key: bytes, header: bytes, cipher: bytes) -> str:
    point, pad = number(tag_key[:TAG_BYTES]), number(tag_key[TAG_BYTES:])
    text = len(header).to_bytes(8) + header + cipher
    return one_time_tag(point, pad, text)
