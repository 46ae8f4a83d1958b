"""Keys as words of 32 bits, and how many messages they guard."""

from typing import Final

KEY_WORDS: Final = 8
"""Words of a key of 256 bits."""


def slots(words: int, session_words: int, step_words: int) -> int:
    """Messages that so many words guard: some are taken once, the others for each message."""
    return max(0, words - session_words) // step_words if step_words else 0
