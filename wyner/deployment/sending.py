"""Asking a running controller to queue a message."""

import math
import queue
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from protocol.messages import SendCommand, SendReply
from protocol.topics import key_of
from runtime.inbox import Inbox

if TYPE_CHECKING:
    from runtime.bus import Bus

REPEAT_S: Final = 0.1
"""Seconds after which a command that was not answered is published again."""


@dataclass(frozen=True)
class Queued:
    """A message that a controller has queued.

    Parameters
    ----------
    reply : SendReply
    size : int
        Bytes of the message.
    loop : str
    run : str, optional
        The run's folder; None where the loop was named by its endpoints.
    """

    reply: SendReply
    size: int
    loop: str
    run: str | None

    def to_json(self) -> dict[str, Any]:
        """Its id, its place in the queue, and whose queue it is."""
        id, queued = self.reply.id, self.reply.queued
        return {"id": id, "bytes": self.size, "queued": queued, "loop": self.loop, "run": self.run}

    def __str__(self) -> str:
        """One line."""
        where = f"loop {self.loop}" if self.run is None else f"run {self.run}, loop {self.loop}"
        return (
            f"queued as {self.reply.id} at {where}: {self.size} bytes, {self.reply.queued} not "
            "delivered yet"
        )


def ask(management: "Bus", loop: str, command: SendCommand, until: float) -> SendReply | None:
    """Publish a command again and again until it is answered; None where it is not in time.

    Replies to other operators arrive too. The command is not repeated for each of them: many
    operators would flood the bus.
    """
    received: Inbox[bytes] = Inbox()
    management.subscribe(
        key_of(SendReply, loop), lambda _key, reply, _t_ns: received.put(reply, len(reply))
    )
    publisher = management.publisher(key_of(SendCommand, loop))
    again = -math.inf
    while (now := time.monotonic()) < until:
        if now >= again:
            publisher.put(command.wire())
            again = now + REPEAT_S
        try:
            reply = SendReply.model_validate_json(received.get(timeout=again - now))
        except (queue.Empty, ValidationError):
            continue
        if reply.id == command.id:
            return reply
    return None
