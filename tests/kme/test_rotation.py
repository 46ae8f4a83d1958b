"""What two ends say to each other while they take a key into use."""

import json
import socket
import ssl
import time
from contextlib import ExitStack
from pathlib import Path
from typing import cast

import pytest

from wyner.deployment.certificates import ensure_certificates
from wyner.kme.client import KeyClient
from wyner.kme.identity import common_name, tls_context
from wyner.kme.rotation import MOST_AT_ONCE, NotRotated, Reception, connected, follow


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (b"", "the other end: hung up without a word"),  # its key server had no key
        (b"\xff\n", "the other end: expected an object"),
        (b"hello\n", "the other end: expected an object"),
        (json.dumps(["a list"]).encode() + b"\n", "the other end: expected an object"),
    ],
)
def test_a_partner_that_names_no_key_is_told_in_words(said: bytes, told: str) -> None:
    here, there = socket.socketpair()
    with here, there:
        there.sendall(said)
        there.shutdown(socket.SHUT_WR)
        with pytest.raises(NotRotated) as raised:
            # Nobody asks the key server before a key has been named.
            follow(cast("ssl.SSLSocket", here), cast("KeyClient", None), "alice", lambda key: None)
    assert str(raised.value) == told


@pytest.mark.slow
def test_silent_connections_by_the_hundred_hold_no_master_up(tmp_path: Path) -> None:
    ensure_certificates(tmp_path, dict.fromkeys(("alice", "bob"), ("localhost",)), 2)
    mine, theirs = (
        tls_context(tmp_path / "alice", server=False),
        tls_context(tmp_path / "bob", server=True),
    )
    with socket.create_server(("127.0.0.1", 0)) as listening, ExitStack() as opened:
        listening.settimeout(0.2)
        address = "localhost", listening.getsockname()[1]
        reception = Reception(listening, theirs)
        for _ in range(2 * MOST_AT_ONCE):
            opened.enter_context(socket.create_connection(address))
        began = time.monotonic()
        opened.enter_context(connected(address, mine))
        while True:
            try:
                line = opened.enter_context(reception.next(10.0))
                break
            except NotRotated:  # one of those that were sent away
                continue
        assert time.monotonic() - began < 4.0  # the silent ones have five seconds each
        assert common_name(line.getpeercert()) == "alice"
