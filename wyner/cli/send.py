"""``wyner send``: hand a running controller a message."""

import argparse
import queue
import time
from typing import Final

from protocol.messages import SendCommand, SendReply
from protocol.runtime.endpoints import add_endpoint_arguments, endpoints_of, loop_of
from protocol.runtime.inbox import Inbox
from protocol.runtime.options import message_of
from protocol.runtime.process import Failure, UsageError, new_id
from protocol.topics import key_of
from wyner.cli.options import add_run_argument, joined

REPEAT_S: Final = 0.1


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the subcommand."""
    parser = subparsers.add_parser("send", help="hand a running controller a message to deliver")
    parser.add_argument("text", nargs="?", metavar="TEXT", help="the message")
    parser.add_argument("--file", metavar="F", help="a file that holds the message")
    parser.add_argument("--id", metavar="ID", help="the same id is queued once (default: random)")
    parser.add_argument("--timeout", type=float, default=5.0, metavar="S", help="seconds to wait")
    add_run_argument(parser)
    add_endpoint_arguments(parser, "operator")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Repeat the command until the controller has answered it."""
    from pydantic import ValidationError

    from protocol.runtime.bus import TransportError
    from protocol.runtime.zenoh_bus import open_bus

    if (args.text is None) == (args.file is None):
        raise UsageError("expected TEXT or --file F, and one of them only")
    if not args.timeout > 0:
        raise UsageError(f"--timeout: got {args.timeout}, expected more than 0")
    payload = message_of(args.text, args.file)
    assert payload is not None
    try:
        command = SendCommand(id=args.id or new_id(), payload=payload)
    except ValidationError:
        raise UsageError(
            f"--id: got {args.id!r}, expected 1 to 64 letters, digits, dots, dashes or underscores"
        ) from None
    joined(args, "operator")
    loop = loop_of(args)
    ends = endpoints_of(args, "operator", "ops")
    answers: Inbox[bytes] = Inbox()
    try:
        with open_bus(ends) as ops:
            ops.subscribe(
                key_of(SendReply, loop), lambda _key, reply, _t_ns: answers.put(reply, len(reply))
            )
            publisher = ops.publisher(key_of(SendCommand, loop))
            until = time.monotonic() + args.timeout
            while time.monotonic() < until:
                publisher.put(command.wire())
                try:
                    reply = SendReply.model_validate_json(answers.get(timeout=REPEAT_S))
                except (queue.Empty, ValidationError):
                    continue
                if reply.id != command.id:
                    continue
                if not reply.accepted:
                    raise Failure(reply.detail)
                print(
                    f"queued as {reply.id}: {len(payload)} bytes, {reply.queued} not delivered yet"
                )
                return 0
    except TransportError as error:
        raise UsageError(str(error)) from None
    at = ", ".join((*ends.connect, *ends.listen))
    raise Failure(
        f"no controller of loop {loop!r} answered within {args.timeout:g} s at {at}: "
        "start one (wyner up), or say where it is (--connect ops=tcp/HOST:PORT, --loop ID)"
    )
