"""``wyner send``: hand a running controller a message."""

import argparse
import json
import math
import queue
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from protocol.messages import SendCommand, SendReply
from protocol.text import printable
from protocol.topics import key_of
from runtime.bus_options import BusOptions, add_service_arguments, endpoints_of, loop_of
from runtime.errors import DONE, Failure, UsageError
from runtime.ids import new_id
from runtime.inbox import Inbox
from runtime.options import message_of, picked
from runtime.services import CONTROLLER_MANAGEMENT
from wyner.cli.options import add_run_argument, is_told, joined
from wyner.deployment.running import names_of

if TYPE_CHECKING:
    from runtime.bus import Bus
    from wyner.deployment.running import RunningLoop

REPEAT_S: Final = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Queue a message at the controller of a run that goes on, and wait until it has it."
    )
    parser.add_argument(
        "text",
        metavar="TEXT",
        help="the message; - reads it from standard input, @FILE from a file",
    )
    parser.add_argument("--id", metavar="ID", help="the same id is queued once (default: random)")
    parser.add_argument(
        "--timeout",
        type=float,
        default=5.0,
        metavar="S",
        help="seconds to wait for a run to be there, and then for its answer (default: 5)",
    )
    parser.add_argument("--json", action="store_true", help="one object on standard output")
    add_run_argument(parser)
    add_service_arguments(parser, "operator")


def run(args: argparse.Namespace) -> int:
    """Repeat the command until the controller has answered it."""
    from pydantic import ValidationError

    from runtime.bus import TransportError
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
    run, buses = joined(told, args.run_name, "operator", args.timeout)
    _check_own(run, told, args.run_name)
    loop = loop_of(buses.loop)
    ends = endpoints_of(buses, "operator", "management")
    until = time.monotonic() + args.timeout
    try:
        with open_bus(ends, args.timeout) as management:
            reply = answer(management, loop, command, until)
    except TransportError as error:
        raise UsageError(str(error)) from None
    if reply is not None:
        if not reply.accepted:
            raise Failure(reply.detail)
        at = None if run is None else run.seen_from(Path.cwd())
        print_reply(reply, len(payload), loop, at, as_json=args.json)
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


def _check_own(run: "RunningLoop | None", told: BusOptions, run_name: str | None) -> None:
    """Refuse a loop that nobody named and that is not of this folder: it may be a stranger's.

    Raises
    ------
    UsageError
        When it is another folder's run, or services that somebody started by hand.
    """
    if run_name is not None or is_told(told):
        return
    if run is None:
        raise UsageError(
            f"no run of this user on this machine, and services at {CONTROLLER_MANAGEMENT} that "
            "may be anybody's; where they are meant expected "
            f"--connect management={CONTROLLER_MANAGEMENT}"
        )
    if not Path(run.run_dir).is_relative_to(Path.cwd()):
        raise UsageError(
            f"the one run on this machine, {printable(run.run_dir)}, is not of this folder; where "
            f"it is meant expected --run {printable(names_of([run]))}"
        )


def print_reply(reply: SendReply, size: int, loop: str, run: str | None, *, as_json: bool) -> None:
    """Tell that a message was taken in, and by which loop of which run."""
    if as_json:
        told = {"id": reply.id, "bytes": size, "queued": reply.queued, "loop": loop, "run": run}
        print(json.dumps(told))
    else:
        where = f"loop {loop}" if run is None else f"run {printable(run)}, loop {loop}"
        print(f"queued as {reply.id} at {where}: {size} bytes, {reply.queued} not delivered yet")


def answer(management: "Bus", loop: str, command: SendCommand, until: float) -> SendReply | None:
    """Say the command again and again until it is answered; None where it is not in time.

    Others who wait hear the same answers: saying it on each of them would be a flood.
    """
    from pydantic import ValidationError

    heard: Inbox[bytes] = Inbox()
    management.subscribe(
        key_of(SendReply, loop), lambda _key, reply, _t_ns: heard.put(reply, len(reply))
    )
    publisher = management.publisher(key_of(SendCommand, loop))
    again = -math.inf
    while (now := time.monotonic()) < until:
        if now >= again:
            publisher.put(command.wire())
            again = now + REPEAT_S
        try:
            reply = SendReply.model_validate_json(heard.get(timeout=again - now))
        except (queue.Empty, ValidationError):
            continue
        if reply.id == command.id:
            return reply
    return None
