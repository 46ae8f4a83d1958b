"""Keys as words of 32 bits, and how many messages they guard."""

from typing import Final

KEY_WORDS: Final = 8
"""Words of a key of 256 bits."""


def slots(words: int, session_words: int, step_words: int) -> int:
    """Messages that so many words guard: some are taken once, the others for each message.

    One is kept for the farewell: the batch is used up, and there is none after it.
    """
    return max(0, (words - session_words) // step_words - 1) if step_words else 0
