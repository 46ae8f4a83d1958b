"""Where a bus listens and connects: endpoints as Zenoh writes them, and the files of TLS."""

import errno
import re
import secrets
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import ip_address
from itertools import chain, islice
from pathlib import Path
from typing import Final, Self

from runtime.bus import TransportError

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
class Addresses:
    """Where one bus listens and connects; the parameters of :class:`ZenohBus`."""

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    client: bool = False
    tls: TlsFiles | None = None


def check_endpoint(endpoint: str, option: str = "endpoint", *, tls: bool = False) -> str:
    """Return ``endpoint`` when it reads ``tcp/HOST:PORT``, or ``tls/HOST:PORT`` with ``tls``.

    Without ``tls`` it may be ``udp/HOST:PORT`` too: there a lost datagram stays lost. Where HOST is
    a multicast group each message is one datagram, whoever listens. ``option`` is what gave it.

    Raises
    ------
    TransportError
        When it does not.
    """
    protocols = ("tls",) if tls else ("tcp", "udp")
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or int(found[3]) > 65535 or found[1] not in protocols:
        raise TransportError(f"{option}: got {endpoint!r}, expected {protocols[0]}/HOST:PORT")
    return endpoint


def host_of(endpoint: str) -> str:
    """The host of an endpoint, or of a link's locator."""
    found = _ENDPOINT.fullmatch(endpoint)
    return "" if found is None else found[2].strip("[]")


def is_group(endpoint: str) -> bool:
    """Whether an endpoint is a multicast group: a message to it leaves once, whoever listens."""
    try:
        return endpoint.startswith("udp/") and ip_address(host_of(endpoint)).is_multicast
    except ValueError:  # a name
        return False


def appearances(links: Iterable[tuple[str, str]], groups: int, *, routed: bool) -> int:
    """How often a message leaves by these links, as far as an end can know; 1 at least.

    Parameters
    ----------
    links : iterable of (str, str)
        Of each link to one other: this end's locator, and the other's.
    groups : int
        Multicast groups.
    routed : bool
        The links lead to a router, which sends each message on once more at least. To how many
        it does only the router knows.
    """
    within = beyond = 0
    for here, there in links:
        if _one_machine(host_of(here), host_of(there)):
            within += 1
        else:
            beyond += 2 if routed else 1
    beyond += groups
    # Within the machine nobody hears the link to the partner; every other one is a tap's.
    return max(1, beyond + within if beyond else within - 1)


def _one_machine(here: str, there: str) -> bool:
    try:
        return here == there or ip_address(there.partition("%")[0]).is_loopback
    except ValueError:
        return False


LOWEST_PORT: Final = 10_000
LARGEST_PORT: Final = 65_535
CLIENT_PORTS: Final = Path("/proc/sys/net/ipv4/ip_local_port_range")


def free_endpoints(count: int) -> list[str]:
    """``count`` distinct free loopback endpoints that this function gives to no other process.

    The listener comes later, and may be started again while its clients try to connect. So no port
    is one that the kernel may give to a client (its range is `kernel_ports`), and each is reserved
    by an abstract Unix socket, which the kernel frees when this process ends.

    Raises
    ------
    TransportError
        When so many are not free.
    """
    clients = kernel_ports()
    ports = [port for port in range(LOWEST_PORT, LARGEST_PORT + 1) if port not in clients]
    first = secrets.randbelow(len(ports) or 1)  # programs that start together rarely meet
    tried = chain(ports[first:], ports[:first])
    found = list(islice((port for port in tried if _is_free(port) and taken_down(port)), count))
    if len(found) < count:
        raise TransportError(f"ports: {len(found)} are free for listeners, expected {count}")
    return [f"tcp/127.0.0.1:{port}" for port in found]


def kernel_ports() -> range:
    """Ports that the kernel gives to clients, one of which may connect before a listener binds."""
    try:
        first, last = map(int, CLIENT_PORTS.read_text(encoding="ascii").split())
    except (OSError, ValueError):  # another system: what IANA sets aside for clients
        return range(49152, LARGEST_PORT + 1)
    return range(first, last + 1)


def _is_free(port: int) -> bool:
    with socket.socket() as one:
        try:
            one.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def taken_down(port: int) -> bool:
    """Reserve the port for this process. False where another process has reserved it."""
    name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        name.bind(f"\0wyner-port-{port}")
    except OSError as error:
        name.close()
        return error.errno != errno.EADDRINUSE  # a system without such names has to do without
    name.detach()  # open until the process ends, however it does
    return True
