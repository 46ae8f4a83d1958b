"""Endpoints that a program picks for its services."""

import socket

import pytest

from runtime import addresses
from runtime.addresses import free_endpoints, kernel_ports
from runtime.bus import TransportError
from tests.support.programs import python


def test_two_programs_at_once_are_given_different_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(addresses, "LOWEST_PORT", 20_000)
    monkeypatch.setattr(addresses, "LARGEST_PORT", 20_039)
    first = free_endpoints(10)
    assert len(set(first)) == 10
    code = (
        "from runtime import addresses\n"
        "addresses.LOWEST_PORT, addresses.LARGEST_PORT = 20_000, 20_039\n"
        "print(*addresses.free_endpoints(10))\n"
    )
    second = python("-c", code).stdout.split()
    assert len(set(second)) == 10
    assert not set(first) & set(second)
    with pytest.raises(TransportError):
        free_endpoints(40)


def test_no_port_is_one_that_the_kernel_may_give_to_a_client() -> None:
    """A client that connects while a killed listener is away would else take its port."""
    clients = kernel_ports()
    with socket.create_server(("127.0.0.1", 0)) as server:
        with socket.create_connection(server.getsockname()) as client:
            assert client.getsockname()[1] in clients
        assert server.getsockname()[1] in clients
    ports = [int(endpoint.rpartition(":")[2]) for endpoint in free_endpoints(50)]
    assert not set(ports) & set(clients)
