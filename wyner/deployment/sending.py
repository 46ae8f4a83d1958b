"""Asking a running controller to queue a message."""

import math
import queue
import time
from typing import TYPE_CHECKING, Final

from pydantic import ValidationError

from protocol.messages import SendCommand, SendReply
from protocol.topics import key_of
from runtime.inbox import Inbox
from wyner.printout import Printout

if TYPE_CHECKING:
    from runtime.bus import Bus

REPEAT_S: Final = 0.1
"""Seconds after which a command that was not answered is published again."""


def queued(reply: SendReply, size: int, loop: str, run: str | None) -> Printout:
    """What is said of a message that a controller has queued.

    Parameters
    ----------
    reply : SendReply
    size : int
        Bytes of the message.
    loop : str
    run : str, optional
        The run's folder; None where the loop was named by its endpoints.
    """
    id, waiting = reply.id, reply.queued
    where = f"loop {loop}" if run is None else f"run {run}, loop {loop}"
    line = f"queued as {id} at {where}: {size} bytes, {waiting} not delivered yet"
    told = {"id": id, "bytes": size, "queued": waiting, "loop": loop, "run": run}
    return Printout(told, [line])


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
