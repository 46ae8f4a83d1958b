"""The messages of the reading study: English sentences of 48 to 59 characters.

None of them is in the text from which English is counted (a test).
"""

from pathlib import Path
from typing import Final

SENTENCES: Final = tuple(
    Path(__file__).with_name("sentences.txt").read_text(encoding="ascii").splitlines()
)
