"""Key expressions: the only place with their literals.

A key is ``BASE/v2/LOOP/TOPIC``. The version is a plain chunk (a wildcard does not match a verbatim
``@`` chunk), the loop id lets many loops share one network, and the topic stands with its message
in :mod:`protocol.messages`.
"""

import re

from protocol.messages import Message

BASE = "wyner"
VERSION = "v2"
DEFAULT_LOOP = "loop"

_LOOP = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def check_loop(loop: str) -> str:
    """Return ``loop`` when it may stand as one chunk of a key.

    Raises
    ------
    ValueError
        When it may not.
    """
    if not _LOOP.fullmatch(loop):
        raise ValueError(
            f"loop: got {loop!r}, expected 1 to 64 letters, digits, dots, dashes or underscores"
        )
    return loop


def key_of(message_type: type[Message], loop: str) -> str:
    """The key on which messages of a type travel in one loop."""
    return f"{BASE}/{VERSION}/{check_loop(loop)}/{message_type.topic}"


def every_loop(message_type: type[Message]) -> str:
    """The key expression that fits messages of a type in all loops."""
    return f"{BASE}/{VERSION}/*/{message_type.topic}"
