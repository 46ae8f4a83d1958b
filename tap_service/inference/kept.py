"""How much of what she infers is kept: memory stays bounded over any run."""

from typing import Final

KEPT_SYMBOLS: Final = 32768
"""Message symbols that a belief keeps, the newest."""

KEPT_MESSAGES: Final = 64
"""Whole messages that a belief keeps, the newest."""
