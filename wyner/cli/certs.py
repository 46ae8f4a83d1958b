"""``wyner certs``: certificates for each service."""

import argparse
from pathlib import Path
from typing import Final

from runtime.errors import DONE, Failure, UsageError
from runtime.services import BUSES, SERVICES

DAYS: Final = 365
"""Of validity."""


def default_names() -> list[str]:
    """The router, and everybody who takes part on a bus."""
    return ["router", *SERVICES]


def default_hosts(name: str) -> list[str]:
    """Where a service is reached when nothing is said: this machine, and its aliases."""
    return [name, *(f"{name}.{bus}" for bus in BUSES), "localhost", "127.0.0.1", "::1"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Make an authority in FOLDER and, for each service, a folder with ca.pem, "
        "cert.pem and key.pem to give to --tls. They are valid for a year; what is there and valid "
        "for another day is kept."
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where they are written")
    parser.add_argument(
        "--name",
        action="append",
        metavar="NAME[=HOST,...]",
        help="a service and the host names or addresses under which it is reached; may be "
        f"repeated (default: {', '.join(default_names())}, "
        "each on this machine and in the containers)",
    )


def run(args: argparse.Namespace) -> int:
    """Make what is missing, and say which names were made and which were kept."""
    from wyner.deployment.certificates import (
        CertificateError,
        check_host,
        check_name,
        ensure_certificates,
    )

    problems = []
    hosts: dict[str, list[str]] = {}
    for text in args.name or default_names():
        name, separator, listed = text.partition("=")
        theirs = [h for h in listed.split(",") if h]
        try:
            check_name(name)
            for host in theirs:
                check_host(host)
        except CertificateError as error:
            problems.append(f"--name {text}: {error}")
            continue
        if separator and not theirs:
            problems.append(f"--name: got {text!r}, expected NAME or NAME=HOST,...")
        # What is listed is added to the defaults, so that a test on the same machine still works.
        hosts[name] = [*dict.fromkeys([*default_hosts(name), *theirs])]
    if problems:
        raise UsageError(problems)
    try:
        made = ensure_certificates(args.folder, hosts, DAYS)
    except CertificateError as error:
        raise Failure(f"{args.folder}: {error}") from None
    for name in hosts:
        print(f"{'made' if name in made else 'kept'} {args.folder / name}")
    return DONE
