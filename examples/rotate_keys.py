"""A fresh key at two sites again and again, for a VPN: each end asks the `wyner kme` of its site.

    rotate_keys.py bob --kme localhost:8014 --tls certs/alice --connect localhost:9014
    rotate_keys.py alice --kme localhost:8015 --tls certs/bob --listen localhost:9014

The program after --run gets each key in base64 on its standard input.
"""

import argparse
import base64
import hmac
import shlex
import socket
import socketserver
import ssl
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from protocol.secret.records import Key
from wyner.kme.client import KeyClient, NoKey
from wyner.kme.identity import common_name, tls_context

parser = argparse.ArgumentParser(description="A fresh key at two sites again and again.")
parser.add_argument("partner", help="the name in its certificate")
for option in ("--kme", "--connect", "--listen"):
    parser.add_argument(option, metavar="HOST:PORT")
parser.add_argument("--tls", type=Path, help="with ca.pem, cert.pem, key.pem")
parser.add_argument("--every", type=float, default=120.0, help="seconds (120)")
parser.add_argument("--run", default="true", help="gets each key")
given = parser.parse_args()
host, _, port = (given.connect or given.listen).rpartition(":")
entity, _, its_port = given.kme.rpartition(":")
site = KeyClient(entity, int(its_port), tls_context(given.tls, server=False))
tls = tls_context(given.tls, server=given.connect is None)


def met(line: ssl.SSLSocket) -> ssl.SSLSocket:
    """The line, where the partner's certificate is at its other end."""
    if (found := common_name(line.getpeercert())) != given.partner:
        raise ValueError(f"certificate: got {found!r}, expected {given.partner!r}")
    return line


def use(key: Key) -> bytes:
    """Hand the key to the program; what proves to the other end that it is in use here."""
    text = base64.b64encode(key.key) + b"\n"
    subprocess.run(shlex.split(given.run), input=text, check=True, timeout=20)
    print(f"in use: {key.key_id}", flush=True)
    return hmac.digest(key.key, key.key_id.encode(), "sha256")


def lead() -> None:
    """Fetch a key, name it to the follower, and use it once the follower does."""
    with socket.create_connection((host, int(port)), 30) as plain:
        line = met(tls.wrap_socket(plain, server_hostname=host))
        (key,) = site.enc_keys(given.partner)  # now: while the partner is away it would be lost
        line.sendall(key.key_id.encode() + b"\n")
        proof = line.makefile("rb").read(32)
        if not hmac.compare_digest(proof, hmac.digest(key.key, key.key_id.encode(), "sha256")):
            raise ValueError(f"{given.partner} does not use {key.key_id}")
        use(key)
    time.sleep(given.every)


def follow(plain: socket.socket) -> None:
    """Fetch the key that the leader names, use it, and prove that."""
    plain.settimeout(5)
    with tls.wrap_socket(plain, server_side=True) as line:
        named = met(line).makefile("rb").readline(100).decode().strip()
        (key,) = site.dec_keys(given.partner, [named])
        line.sendall(use(key))


def attempt(turn: Callable[[], None]) -> None:
    """A turn that may fail: the next one makes it good."""
    try:
        turn()
    except (OSError, ValueError, NoKey, subprocess.SubprocessError) as error:
        print(f"no new key: {error}", flush=True)
        time.sleep(2)


class Follower(socketserver.BaseRequestHandler):
    """A thread for each connection: a silent one holds nobody up."""

    def handle(self) -> None:
        """One turn."""
        attempt(lambda: follow(self.request))


if given.connect is not None:
    while True:
        attempt(lead)
socketserver.TCPServer.allow_reuse_address = True
with socketserver.ThreadingTCPServer((host, int(port)), Follower) as server:
    server.serve_forever()
