"""The queue of messages to deliver, and the operator's command that adds to it."""

from typing import Protocol
from zlib import crc32

from protocol.link.effects import Effects, Publish, Tell
from protocol.link.records import INITIAL_ID
from protocol.link.state import EndState
from protocol.messages import SendCommand, SendReply
from protocol.schemes.framing import MAX_PAYLOAD


class MessageQueue(Protocol):
    """The messages to deliver, in order, numbered from 0, as the journal has them."""

    queued: int
    """How many there ever were."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``; None while it is not queued, and once it was delivered."""

    def crc_of(self, identifier: str) -> int | None:
        """The CRC-32 of the message that was queued under this identifier, or None."""

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""


class Outbox:
    """Queues messages.

    Parameters
    ----------
    state : EndState
        The controller's.
    messages : MessageQueue
    """

    def __init__(self, state: EndState, messages: MessageQueue) -> None:
        self._state = state
        self._messages = messages

    def begin(self, payload: bytes) -> Effects:
        """Queue the message that the controller is started with, once in the journal's life."""
        if self._messages.crc_of(INITIAL_ID) is None:
            yield from self._queue(SendCommand(id=INITIAL_ID, payload=payload))

    def commanded(self, command: SendCommand, delivered: int) -> Effects:
        """The operator hands over a message; the same identifier is queued once.

        Parameters
        ----------
        command : SendCommand
        delivered : int
            Messages that are delivered, and wait no more.
        """
        size, queued = len(command.payload), self._messages.crc_of(command.id)
        waiting = self._messages.queued - delivered
        accepted, detail = False, ""
        if command.id == INITIAL_ID:
            detail = f"id: {INITIAL_ID!r} is the message that the controller is started with"
        elif size > MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected at most {MAX_PAYLOAD}"
        elif queued is None:
            accepted = True
            waiting += 1
            yield from self._queue(command)
        elif queued == crc32(command.payload):
            accepted, detail = True, "already queued"
        else:
            detail = f"id: {command.id!r} is another message's"
        yield Publish(SendReply(id=command.id, accepted=accepted, queued=waiting, detail=detail))

    def _queue(self, command: SendCommand) -> Effects:
        """Traced first: what is queued in the journal must not be missing from the trace.

        The record goes with it. The step under way was decided without this message: should it be
        counted again, then so too. On the disk before it is accepted.
        """
        yield Tell(command)
        yield self._state.save(queued=command, durable=True)
