"""Messages on their way in a test: as bytes, as a network has them."""

from typing import NamedTuple

from protocol.messages import Message


class Mail(NamedTuple):
    """A message's type, which gives the topic, and its bytes."""

    kind: type[Message]
    payload: bytes


def mail(message: Message) -> Mail:
    """What a message is on its way."""
    return Mail(type(message), message.wire())
