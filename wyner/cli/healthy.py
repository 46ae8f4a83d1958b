"""``wyner status --healthy``: whether a service advances. For health checks, and by hand.

A service that runs but whose loop stands still is not healthy. So the check looks twice: the
service's own report must be fresh, and what it counts must grow between the two looks.
"""

import argparse
import json
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from protocol.text import printable
from runtime.errors import DONE, FAILED, Failure, UsageError
from runtime.health import Look, look_at_status
from runtime.run_folder import loops_below
from runtime.services import SERVICES

MAX_AGE_S = 5.0
"""A report older than this was written by a service that is frozen or gone; it writes one each
second (the tap each two)."""

WITHIN_S = 3.0
POLL_S = 0.1


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a health check."""
    group = parser.add_argument_group(
        "health check",
        "Exit 0 when a service's report is fresh and what it counts has grown within a few "
        "seconds: transitions of the controller and the plant, messages captured by the tap. For a "
        "router: when it takes a connection.",
    )
    what = group.add_mutually_exclusive_group()
    what.add_argument(
        "--healthy",
        dest="service",
        choices=(able := [name for name in SERVICES if SERVICES[name].reports]),
        metavar="SERVICE",
        help=f"one that writes below RUN_DIR: {', '.join(able)}",
    )
    what.add_argument("--endpoint", metavar="ENDPOINT", help="a router's, such as tcp/router:7447")
    group.add_argument(
        "--within",
        type=float,
        default=WITHIN_S,
        metavar="S",
        help=f"seconds in which the count must grow (default: {WITHIN_S:g})",
    )


def advances(look: Callable[[], Look], within_s: float) -> Look:
    """Look until the count grows.

    Raises
    ------
    Failure
        When the report is stale, or the count did not grow within ``within_s`` seconds.
    """
    first = look()
    if first.age_s > MAX_AGE_S:
        raise Failure(f"last report {first.age_s:.1f} s ago, expected {MAX_AGE_S:g} s at most")
    until = time.monotonic() + within_s
    lowest = first.count
    while True:
        last = look()
        if last.count > lowest:
            return last
        lowest = last.count  # a new session counts from nought again
        if time.monotonic() >= until:
            raise Failure(f"stands still: {last.text}, no more within {within_s:g} s")
        time.sleep(POLL_S)


def takes_connections(endpoint: str, within_s: float) -> None:
    """Connect to an endpoint and hang up.

    Raises
    ------
    UsageError
        When it reads like none.
    Failure
        When nobody answers.
    """
    address = endpoint.partition("/")[2].partition("#")[0]
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(f"--endpoint: got {endpoint!r}, expected PROTOCOL/HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=within_s).close()
    except (OSError, OverflowError) as error:
        raise Failure(f"{endpoint}: no answer: {error}") from None


def check_health(args: argparse.Namespace) -> int:
    """Look, and print one line, or one object."""
    if not 0 < args.within <= 60:
        raise UsageError(f"--within: got {args.within:g}, expected more than 0 and at most 60")
    if args.service is not None and args.run_dir is None:
        raise UsageError("--healthy: expected RUN_DIR as well")
    loops = [] if args.endpoint is not None else loops_below(args.run_dir)
    wrong: dict[str, str] = {}
    try:
        if loops:
            detail, wrong = _fleet(args, loops)
        else:
            detail = _endpoint(args) if args.endpoint is not None else _service(args)
    except Failure as error:
        if not args.json:
            raise
        detail, wrong = str(error), {"": str(error)}
    if args.json:
        told = {"healthy": not wrong, "service": args.service, "endpoint": args.endpoint}
        unwell = {name: why for name, why in wrong.items() if name}
        loops_told = {"loops": len(loops), "unwell": unwell}
        print(json.dumps({**told, "detail": detail, **loops_told}))
        return FAILED if wrong else DONE
    for name, why in wrong.items():
        print(printable(f"{name}: {why}"))
    if wrong:
        raise Failure(detail)
    print(printable(detail))
    return DONE


def _endpoint(args: argparse.Namespace) -> str:
    takes_connections(args.endpoint, args.within)
    return f"{args.endpoint} takes connections"


def _service(args: argparse.Namespace) -> str:
    folder = args.run_dir / args.service
    seen = advances(lambda: look_at_status(folder, time.time()), args.within)
    if seen.health.startswith("bad"):
        raise Failure(seen.health.removeprefix("bad: "))
    return f"{args.service} advances: {seen.text}"


def _fleet(args: argparse.Namespace, loops: list[Path]) -> tuple[str, dict[str, str]]:
    """Look at every loop of a fleet, at all of them while one waits; those that are not well."""

    def one(loop: Path) -> str:
        folder = loop / args.service
        try:
            told = advances(lambda: look_at_status(folder, time.time()), args.within).health
        except Failure as error:
            return str(error)
        return told.removeprefix("bad: ") if told.startswith("bad") else ""

    with ThreadPoolExecutor(max_workers=32) as threads:
        texts = zip(loops, threads.map(one, loops), strict=True)
        wrong = {loop.name: text for loop, text in texts if text}
    if wrong:
        return f"{len(wrong)} of {len(loops)} loops do not advance", wrong
    return f"{args.service} advances on all {len(loops)} loops", {}
