"""``wyner rotate``: take a fresh key into use at both ends, again and again."""

import argparse
import socket
import ssl
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from runtime.errors import DONE, UsageError
from runtime.logs import logger
from runtime.options import add_check_argument, at_least
from runtime.signals import stop_on_signals
from wyner.cli.options import host_port

if TYPE_CHECKING:
    from wyner.kme.client import KeyClient
    from wyner.kme.rotation import Use

EVERY_S: Final = 120.0
RETRY_S: Final = 2.0
LOOK_S: Final = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "For a program that takes a new master key now and then, such as a VPN. Run it at both "
        "sites. Each fetches the same key from the `wyner kme` of its own site; when each has "
        "proved to the other that it has it, both hand it to their program. One end connects and "
        "asks for new keys (the master), the other listens (the slave)."
    )
    parser.add_argument("--kme", required=True, metavar="HOST:PORT", help="this site's `wyner kme`")
    parser.add_argument(
        "--tls", required=True, type=Path, metavar="FOLDER", help="with ca.pem, cert.pem, key.pem"
    )
    parser.add_argument(
        "--partner-sae",
        required=True,
        metavar="NAME",
        help="the other end's name in its certificate",
    )
    ends = parser.add_mutually_exclusive_group(required=True)
    ends.add_argument("--connect", metavar="HOST:PORT", help="be the master; where the slave is")
    ends.add_argument("--listen", metavar="HOST:PORT", help="be the slave")
    parser.add_argument(
        "--every", type=float, metavar="S", help=f"the master's: seconds ({EVERY_S:g})"
    )
    parser.add_argument("--count", type=int, metavar="N", help="end after N keys (default: never)")
    parser.add_argument(
        "--run",
        dest="program",
        metavar="COMMAND",
        help="gets each key in base64 on its standard input, and its id as WYNER_KEY_ID",
    )
    add_check_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Rotate until a signal comes, or ``--count`` is reached."""
    from wyner.kme.client import KeyClient
    from wyner.kme.identity import tls_context
    from wyner.kme.rotation import hand_to

    entity = host_port("--kme", args.kme)
    other = host_port(
        "--listen" if args.connect is None else "--connect", args.connect or args.listen
    )
    if args.every is not None and (args.connect is None or not 0 < args.every <= 86400):
        expected = "more than 0, at most 86400, and with --connect"
        raise UsageError(f"--every: got {args.every:g}, expected {expected}")
    at_least("--count", args.count, 1)
    try:
        use = hand_to(args.program) if args.program else lambda _key: None
    except ValueError as error:
        raise UsageError(f"--run: got {args.program!r}: {error}") from None
    if args.check:
        return DONE
    try:
        mine = tls_context(args.tls, server=False)
        theirs = tls_context(args.tls, server=True)
    except OSError as error:
        raise UsageError(f"--tls: {args.tls}: {error.strerror or error}") from None
    client = KeyClient(*entity, mine)
    with stop_on_signals() as stopping:
        if args.connect is not None:
            every_s = EVERY_S if args.every is None else args.every
            _master(args, client, other, mine, use, every_s, stopping)
        else:
            _slave(args, client, other, theirs, use, stopping)
    return DONE


class _Attempts:
    """Attempts to rotate, each new outcome told in a line; the same failure again is not."""

    def __init__(self) -> None:
        self._log = logger("rotate")
        self._last = ""
        self.made = 0

    def make(self, turn: Callable[[], str]) -> bool:
        """Whether a new key came into use."""
        from wyner.kme.rotation import NotRotated

        try:
            self._log.info("%s: the same at both ends, in use", turn())
        except NotRotated as error:
            if str(error) != self._last:
                self._log.warning("no new key: %s", error)
            self._last = str(error)
            return False
        self._last = ""
        self.made += 1
        return True


def _master(
    args: argparse.Namespace,
    client: "KeyClient",
    slave: tuple[str, int],
    tls: ssl.SSLContext,
    use: "Use",
    every_s: float,
    stopping: threading.Event,
) -> None:
    from wyner.kme.rotation import check_partner, connected, lead

    def turn() -> str:
        # The line comes first: a key that is fetched for a partner who is away would be lost.
        with connected(slave, tls) as line:
            check_partner(line, args.partner_sae)
            return lead(line, client, args.partner_sae, use)

    attempts = _Attempts()
    while attempts.made != args.count and not stopping.is_set():
        begun_s = time.monotonic()
        done = attempts.make(turn)
        if attempts.made != args.count:
            pause_s = every_s - (time.monotonic() - begun_s) if done else RETRY_S
            stopping.wait(max(0.0, pause_s))


def _slave(
    args: argparse.Namespace,
    client: "KeyClient",
    here: tuple[str, int],
    tls: ssl.SSLContext,
    use: "Use",
    stopping: threading.Event,
) -> None:
    from wyner.kme.rotation import Reception, check_partner, follow

    def turn() -> str:
        with reception.next(LOOK_S) as line:
            check_partner(line, args.partner_sae)
            return follow(line, client, args.partner_sae, use)

    family = socket.AF_INET6 if ":" in here[0] else socket.AF_INET
    try:
        listening = socket.create_server(here, family=family)
    except OSError as error:
        raise UsageError(f"--listen: {args.listen}: {error.strerror or error}") from None
    with listening:
        listening.settimeout(LOOK_S)
        reception = Reception(listening, tls)
        attempts = _Attempts()
        while attempts.made != args.count and not stopping.is_set():
            try:
                attempts.make(turn)
            except TimeoutError:
                continue
