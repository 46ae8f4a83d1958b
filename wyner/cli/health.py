"""``wyner health``: say whether a service advances. For health checks and for a look by hand.

A service that runs but whose loop stands still is not healthy. So the check looks twice: the
service's own report must be fresh, and what it counts must grow between the two looks.
"""

import argparse
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from protocol.runtime.errors import DONE, Failure, UsageError
from protocol.runtime.run_folder import HEALTH, loops_below
from protocol.runtime.services import SERVICES, Look
from protocol.text import printable

MAX_AGE_S = 5.0
"""A report older than this was written by a service that is frozen or gone; it writes one each
second (the tap each two)."""

WITHIN_S = 3.0
LOOK_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Exit 0 when the service's report is fresh and what it counts has grown within "
        "a few seconds: transitions of the controller and the plant, bytes mirrored by the tap. "
        "For a router: when it takes a connection."
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--service",
        choices=[name for name in SERVICES if SERVICES[name].health],
        help="a service that writes below --run-dir",
    )
    what.add_argument("--endpoint", metavar="ENDPOINT", help="a router's, such as tcp/router:7447")
    parser.add_argument("--run-dir", type=Path, metavar="D", help="the service's run folder")
    parser.add_argument(
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
        time.sleep(LOOK_S)


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


def run(args: argparse.Namespace) -> int:
    """Look, and print one line."""
    if not 0 < args.within <= 60:
        raise UsageError(f"--within: got {args.within:g}, expected more than 0 and at most 60")
    if args.endpoint is not None:
        takes_connections(args.endpoint, args.within)
        print(f"{args.endpoint} takes connections")
        return DONE
    if args.run_dir is None:
        raise UsageError("--service: expected --run-dir D as well")
    look = SERVICES[args.service].health
    assert look is not None
    loops = loops_below(args.run_dir)
    if loops:
        return _fleet(args, look, loops)
    seen = advances(lambda: look(args.run_dir / args.service, time.time()), args.within)
    told = told_by(args.run_dir / args.service)
    if told.startswith("bad"):
        raise Failure(told.removeprefix("bad: "))
    print(f"{args.service} advances: {seen.text}")
    return DONE


def _fleet(args: argparse.Namespace, look: Callable[[Path, float], Look], loops: list[Path]) -> int:
    """Look at every loop of a fleet, at all of them while one waits."""

    def one(loop: Path) -> str:
        folder = loop / args.service
        try:
            advances(lambda: look(folder, time.time()), args.within)
        except Failure as error:
            return f"{loop.name}: {error}"
        told = told_by(folder)
        return f"{loop.name}: {told.removeprefix('bad: ')}" if told.startswith("bad") else ""

    with ThreadPoolExecutor(max_workers=32) as threads:
        wrong = [text for text in threads.map(one, loops) if text]
    for text in wrong:
        print(printable(text))
    if wrong:
        raise Failure(f"{len(wrong)} of {len(loops)} loops do not advance")
    print(f"{args.service} advances on all {len(loops)} loops")
    return DONE


def told_by(folder: Path) -> str:
    """The service's own line, ``ok`` or ``bad`` and why; empty where it has none."""
    try:
        return (folder / HEALTH).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
