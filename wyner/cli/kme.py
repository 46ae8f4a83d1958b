"""``wyner kme``: hand one side's keys to its application, by ETSI GS QKD 014."""

import argparse
import math
import time
from pathlib import Path
from typing import Final

from runtime.errors import DONE, Failure, UsageError, needs
from runtime.logs import RateLimitedLog, logger
from runtime.signals import stop_on_signals
from wyner.cli.options import host_port

RATE: Final = 200.0
POLL_S: Final = 0.1
HEALTH_S: Final = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Serve the keys that the controller or the plant of a run has distilled: ETSI "
        "GS QKD 014 V1.1.1 over mutual TLS. Who asks is the common name of the client's "
        "certificate. Each side gives out its own half, and the partner's half by id."
    )
    parser.add_argument("--run-dir", required=True, type=Path, metavar="D", help="the run's folder")
    parser.add_argument("--side", required=True, choices=("controller", "plant"))
    parser.add_argument(
        "--tls", required=True, type=Path, metavar="FOLDER", help="with ca.pem, cert.pem, key.pem"
    )
    parser.add_argument(
        "--sae", required=True, action="append", metavar="NAME", help="who is served here"
    )
    parser.add_argument(
        "--partner-sae",
        required=True,
        action="append",
        metavar="NAME",
        help="who is, over there; both options may be repeated, once a pair, in the same order at "
        "both ends: each pair gets an equal share of the keys",
    )
    parser.add_argument("--kme", metavar="NAME", help="of this entity (default: kme-SIDE)")
    parser.add_argument("--partner-kme", metavar="NAME", help="of the other (default: kme-SIDE)")
    parser.add_argument(
        "--listen", default="127.0.0.1:8014", metavar="HOST:PORT", help="default: 127.0.0.1:8014"
    )
    parser.add_argument(
        "--rate", type=float, default=RATE, metavar="N", help=f"requests a second ({RATE:g})"
    )


def run(args: argparse.Namespace) -> int:
    """Serve until a signal comes."""
    try:
        import aiohttp  # noqa: F401
    except ImportError:
        raise UsageError(needs("kme", "aiohttp")) from None
    import asyncio

    from protocol.secret.records import StoreError
    from runtime.files import write_atomically
    from runtime.keys.store import KeyStore
    from runtime.run_folder import CONTROLLER_KEYS, HEALTH, PLANT_KEYS
    from wyner.kme.entity import KeyManagementEntity, Names
    from wyner.kme.identity import tls_context
    from wyner.kme.server import KeyServer

    host, port = host_port("--listen", args.listen)
    if not args.rate > 0:
        raise UsageError(f"--rate: got {args.rate:g}, expected more than 0")
    if len(args.sae) != len(args.partner_sae):
        given = f"got {len(args.partner_sae)}, expected one for each of {len(args.sae)} --sae"
        raise UsageError(f"--partner-sae: {given}")
    pairs = tuple(zip(args.sae, args.partner_sae, strict=True))
    for place, pair in enumerate(pairs):
        if pair[0] == pair[1] or pair in pairs[:place]:
            raise UsageError(f"--partner-sae: got {pair[1]!r} twice, expected another")
    partner = "plant" if args.side == "controller" else "controller"
    names = Names(
        kme=args.kme or f"kme-{args.side}",
        partner_kme=args.partner_kme or f"kme-{partner}",
        pairs=pairs,
    )
    try:
        tls = tls_context(args.tls, server=True)
    except OSError as error:
        raise UsageError(f"--tls: {args.tls}: {error.strerror or error}") from None
    log = logger("kme")
    served = ", ".join(f"{mine} (for {theirs})" for mine, theirs in pairs)
    path = args.run_dir / (CONTROLLER_KEYS if args.side == "controller" else PLANT_KEYS)
    try:
        store = KeyStore(path, args.side, create=True)
    except StoreError as error:
        raise UsageError(str(error)) from None
    with store, stop_on_signals() as stopping:
        server = KeyServer(KeyManagementEntity(names, store), args.rate)
        health = args.run_dir / f"kme-{args.side}" / HEALTH

        complaints = RateLimitedLog(log)
        put_back: list[Failure] = []

        def tell(line: str) -> None:
            try:
                write_atomically(health, line.encode())
            except OSError as error:  # keys are given all the same
                complaints.add(f"{health}: {error.strerror}")

        async def serve() -> None:
            stop = asyncio.Event()
            serving = asyncio.create_task(server.serve(host, port, tls, stop))
            serving.add_done_callback(lambda _task: stop.set())
            log.info("%s serves %s at %s: %s", names.kme, served, args.listen, path)
            told_at = -math.inf
            while not (stopping.is_set() or stop.is_set()):
                if (now := time.monotonic()) - told_at >= HEALTH_S:
                    told_at = now
                    tell(server.health())
                complaints.report_held_back()
                try:
                    store.stay()
                except StoreError as error:
                    put_back.append(Failure(str(error)))
                    break
                await asyncio.sleep(POLL_S)
            stop.set()
            await serving
            tell(f"stopped: {server.summary()}")
            complaints.report_held_back(last=True)

        try:
            asyncio.run(serve())
        except OSError as error:
            raise UsageError(f"--listen: {args.listen}: {error.strerror or error}") from None
    if put_back:
        raise put_back[0]
    log.info("stopping")
    return DONE
