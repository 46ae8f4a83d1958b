"""``wyner send``: hand a running controller a message."""

import argparse
import time
from pathlib import Path

from protocol.messages import SendCommand
from protocol.text import printable
from runtime.bus_options import BusOptions, add_service_arguments, endpoints_of
from runtime.chance import new_id
from runtime.errors import DONE, Failure, UsageError
from runtime.options import message_of, picked
from wyner.cli.joining import add_run_argument, joined
from wyner.cli.results import add_json, show
from wyner.deployment.sending import ask, queued


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Queue a message at the controller of a running loop, and wait for its reply."
    )
    parser.add_argument(
        "text",
        metavar="TEXT",
        help="the message; - reads it from standard input, @FILE from a file",
    )
    parser.add_argument(
        "--id", metavar="ID", help="a message of the same id is queued only once (default: random)"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=5.0,
        metavar="S",
        help="seconds to wait for a run to start and for its reply (default: 5)",
    )
    add_json(parser)
    add_run_argument(parser)
    add_service_arguments(parser, "operator")


def run(args: argparse.Namespace) -> int:
    """Repeat the command until the controller has answered it."""
    from pydantic import ValidationError

    from runtime.zenoh_bus import open_bus

    if not args.timeout > 0:
        raise UsageError(f"--timeout: got {args.timeout}, expected more than 0")
    payload = message_of(args.text)
    assert payload is not None
    try:
        command = SendCommand(id=args.id or new_id(), payload=payload)
    except ValidationError:
        raise UsageError(
            f"--id: got {args.id!r}, expected 1 to 64 letters, digits, dots, dashes or underscores"
        ) from None
    told = picked(BusOptions, vars(args))
    run, buses = joined(told, args.run_name, "operator", args.timeout, own=True)
    loop = buses.loop
    ends = endpoints_of(buses, "operator")["management"]
    until = time.monotonic() + args.timeout
    with open_bus(ends, args.timeout) as management:
        reply = ask(management, loop, command, until)
    if reply is not None:
        if not reply.accepted:
            raise Failure(reply.detail)
        at = None if run is None else run.seen_from(Path.cwd())
        show(queued(reply, len(payload), loop, at), args)
        return DONE
    if run is not None:
        where = printable(run.seen_from(Path.cwd()))
        raise Failure(
            f"{command.id}: the run {where} did not answer within {args.timeout:g} s; where it is "
            "only being started, try again or give it longer (--timeout)"
        )
    at = ", ".join((*ends.connect, *ends.listen))
    raise Failure(
        f"no controller of loop {loop!r} answered within {args.timeout:g} s at {at}: "
        "start one (wyner up), or say where it is (--connect management=tcp/HOST:PORT, --loop ID)"
    )
