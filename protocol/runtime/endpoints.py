"""Where a bus listens and connects: endpoints as Zenoh writes them, and the files of TLS."""

import re
import socket
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from protocol.runtime.bus import TransportError

_ENDPOINT: Final = re.compile(
    r"(tcp|tls|udp)/(\[[0-9A-Fa-f:.%]+\]|[A-Za-z0-9._-]+):(\d{1,5})(#.+)?"
)


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """PEM files of one service: the authority it trusts, its own certificate and private key."""

    ca: Path
    certificate: Path
    key: Path

    @classmethod
    def in_folder(cls, folder: Path) -> Self:
        """The files ``ca.pem``, ``cert.pem`` and ``key.pem`` of a folder.

        Raises
        ------
        TransportError
            When one of them is not there.
        """
        files = cls(folder / "ca.pem", folder / "cert.pem", folder / "key.pem")
        for path in (files.ca, files.certificate, files.key):
            if not path.is_file():
                raise TransportError(f"{path}: no such file, expected ca.pem, cert.pem and key.pem")
        return files


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Where one bus listens and connects; the parameters of :class:`ZenohBus`."""

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    client: bool = False
    tls: TlsFiles | None = None
    scouting: bool = False


def check_endpoint(endpoint: str, *, tls: bool = False) -> str:
    """Return ``endpoint`` when it reads ``tcp/HOST:PORT``, or ``tls/HOST:PORT`` with ``tls``.

    Without ``tls`` it may be ``udp/HOST:PORT`` too: there a lost datagram stays lost.

    Raises
    ------
    TransportError
        When it does not.
    """
    protocols = ("tls",) if tls else ("tcp", "udp")
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or int(found[3]) > 65535 or found[1] not in protocols:
        raise TransportError(f"endpoint: got {endpoint!r}, expected {protocols[0]}/HOST:PORT")
    return endpoint


def free_endpoints(count: int) -> list[str]:
    """``count`` distinct loopback endpoints, free a moment ago."""
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [f"tcp/127.0.0.1:{one.getsockname()[1]}" for one in sockets]
