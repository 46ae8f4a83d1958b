"""What two ends say to each other while they take a key into use."""

import json
import socket
import ssl
from typing import cast

import pytest

from wyner.kme.client import KeyClient
from wyner.kme.rotation import NotRotated, follow


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
