"""`smoother`: infers what was missed as `text` does, and expects nothing of a message.

To her every byte is as likely, so that what the language of a message is worth to Eve is what
`text` has beyond her.
"""

from typing import ClassVar

from protocol.knowledge import Knowledge
from tap_service.eavesdroppers.text import Text
from tap_service.inference.expectation import any_bytes


class Smoother(Text):
    """Reads messages of any bytes."""

    name: ClassVar[str] = "smoother"

    def __init__(self, knowledge: Knowledge, *, live: bool = True) -> None:
        super().__init__(knowledge, any_bytes(), live=live)
