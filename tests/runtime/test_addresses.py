"""Endpoints that a program picks for its services."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from runtime import addresses
from runtime.addresses import free_endpoints

ROOT = Path(__file__).resolve().parents[2]


class SamePorts(socket.socket):
    """The kernel may give a port again as soon as nobody listens there."""

    ports: list[int]

    def getsockname(self) -> tuple[str, int]:
        return "127.0.0.1", self.ports.pop(0)


def test_two_programs_at_once_are_given_different_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    first = free_endpoints(3)
    ports = [int(endpoint.rpartition(":")[2]) for endpoint in first]
    assert len(set(ports)) == 3
    code = (
        "import sys\n"
        "from tests.runtime.test_addresses import SamePorts, addresses\n"
        "SamePorts.ports = [int(p) for p in sys.argv[1:]]\n"
        "addresses.socket.socket = lambda *k: SamePorts(*k) if not k else real(*k)\n"
        "print(*addresses.free_endpoints(1))\n"
    ).replace("SamePorts.ports", "real = addresses.socket.socket\nSamePorts.ports")
    spare = 65000 + ports[0] % 500  # nobody asks the kernel for it here
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, ports), str(spare)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert done.stdout.split() == [f"tcp/127.0.0.1:{spare}"]


def test_a_port_is_free_again_once_its_program_has_ended() -> None:
    code = "from runtime.addresses import free_endpoints; print(*free_endpoints(1))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert addresses.taken_down(int(done.stdout.strip().rpartition(":")[2]))
