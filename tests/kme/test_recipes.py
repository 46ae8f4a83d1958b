"""What is done with the keys: a fresh one at both ends again and again, TLS 1.3 and WireGuard."""

import base64
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.support.key_sites import Sites, free_port
from tests.support.patience import PATIENCE_S
from wyner.kme.client import KeyClient, NoKey
from wyner.kme.identity import tls_context

pytest.importorskip("aiohttp")

PROGRAM = Path(__file__).resolve().parents[2] / "examples" / "rotate_keys.py"


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sites]:
    two = Sites(tmp_path_factory.mktemp("recipes"))
    try:
        for side in ("controller", "plant"):
            two.start(side)
        yield two
    finally:
        two.stop()


def client(sites: Sites, side: str, name: str) -> KeyClient:
    tls = tls_context(sites.folder / "certs" / name, server=False)
    return KeyClient("localhost", sites.ports[side], tls)


class Ends:
    """`examples/rotate_keys.py` at both sites, each with the command that gets its keys."""

    def __init__(self, sites: Sites, logs: Path) -> None:
        self.sites, self.logs, self.port = sites, logs, free_port()
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *more: str) -> None:
        side, partner, end = {
            "alice": ("controller", "bob", f"--connect=localhost:{self.port}"),
            "bob": ("plant", "alice", f"--listen=127.0.0.1:{self.port}"),
        }[name]
        command = [
            sys.executable,
            str(PROGRAM),
            partner,
            end,
            "--kme",
            f"localhost:{self.sites.ports[side]}",
            "--tls",
            str(self.sites.folder / "certs" / name),
            *more,
        ]
        with (self.logs / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(command, stdout=log, stderr=log)

    def log(self, name: str) -> str:
        return (self.logs / f"{name}.log").read_text()

    def ids(self, name: str) -> list[str]:
        return re.findall(r"^in use: (\S+)$", self.log(name), re.MULTILINE)

    def until(self, name: str, text: str, times: int = 1) -> None:
        until = time.monotonic() + PATIENCE_S
        while self.log(name).count(text) < times:
            assert time.monotonic() < until, self.log(name)
            time.sleep(0.05)

    def connection(self) -> socket.socket:
        """To bob, once he listens."""
        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                return socket.create_connection(("localhost", self.port), 1)
            except OSError:
                assert time.monotonic() < until
                time.sleep(0.05)

    def stop(self, name: str) -> None:
        self.processes[name].kill()
        self.processes[name].wait()


@pytest.fixture
def ends(sites: Sites, tmp_path: Path) -> Iterator[Ends]:
    sites.add_block(40)
    two = Ends(sites, tmp_path)
    try:
        yield two
    finally:
        for name in two.processes:
            two.stop(name)


def appending(path: Path) -> str:
    return f"tee -a {path}"


@pytest.mark.slow
def test_both_ends_hand_on_the_same_keys_under_the_same_ids(ends: Ends, tmp_path: Path) -> None:
    got = {name: tmp_path / name for name in ("alice", "bob")}
    ends.start("bob", "--run", appending(got["bob"]))
    ends.start("alice", "--every", "0.3", "--run", appending(got["alice"]))
    ends.until("alice", "in use", 3)
    keys = got["alice"].read_text().splitlines()[:3]
    assert keys == got["bob"].read_text().splitlines()[:3]
    ids = ends.ids("alice")[:3]
    assert len(set(ids)) == len(set(keys)) == 3
    assert ids == ends.ids("bob")[:3]


@pytest.mark.slow
def test_while_the_partner_is_away_no_key_is_fetched_and_a_failure_is_made_good(
    ends: Ends, sites: Sites
) -> None:
    status = ("controller", "alice", "/api/v1/keys/bob/status")
    before = sites.ask(*status)[1]["stored_key_count"]
    ends.start("alice", "--every", "60")
    ends.until("alice", "no new key: ")
    assert sites.ask(*status)[1]["stored_key_count"] == before
    ends.start("bob", "--run", "false")
    ends.until("bob", "no new key: Command '['false']'")
    ends.until("alice", "no new key: bob does not use ")
    ends.stop("bob")
    ends.start("bob")
    ends.until("alice", "in use")
    assert ends.ids("alice") == ends.ids("bob")


@pytest.mark.long
def test_silent_connections_by_the_hundred_hold_nobody_up(ends: Ends) -> None:
    ends.start("bob")
    began = time.monotonic()
    ends.start("alice", "--every", "60")
    ends.until("alice", "in use")
    alone_s = time.monotonic() - began
    ends.stop("alice")
    with ExitStack() as opened:
        for _ in range(128):
            opened.enter_context(ends.connection())
        began = time.monotonic()
        ends.start("alice", "--every", "60")
        ends.until("alice", "in use", 2)
        # the silent ones have five seconds each; a machine may be slow
        assert time.monotonic() - began < max(4.5, 3 * alone_s)


def test_nobody_else_is_answered(ends: Ends, sites: Sites) -> None:
    ends.start("bob")
    tls = tls_context(sites.folder / "certs" / "mallory", server=False)
    with tls.wrap_socket(ends.connection(), server_hostname="localhost") as line:
        line.sendall(b"x\n")
        assert line.recv(100) == b""
    ends.until("bob", "no new key: certificate: got 'mallory', expected 'alice'")
    with pytest.raises(NoKey, match="401 SAE 'mallory': not served by kme-plant"):
        client(sites, "plant", "mallory").dec_keys("alice", ["x"])
    with pytest.raises(NoKey, match="400 one or more keys"):
        client(sites, "plant", "bob").dec_keys("alice", ["x"])


# --- TLS 1.3 --------------------------------------------------------------------------------------


def tls_with(server_key: bytes, client_key: bytes, identity: str) -> tuple[bytes, bytes]:
    """What passes by the recipe of docs/keys.md, and what the client says of it."""
    port = free_port()
    common = ["-tls1_3", "-psk_identity", identity, "-psk"]
    server = subprocess.Popen(
        [
            "openssl",
            "s_server",
            "-quiet",
            "-nocert",
            "-naccept",
            "1",
            "-port",
            str(port),
            *common,
            server_key.hex(),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + PATIENCE_S
        while True:
            done = subprocess.run(
                [
                    "openssl",
                    "s_client",
                    "-quiet",
                    "-no_ign_eof",
                    "-connect",
                    f"127.0.0.1:{port}",
                    *common,
                    client_key.hex(),
                ],
                input=b"The old mill, at nine.\n",
                capture_output=True,
                timeout=PATIENCE_S,
                check=False,
            )
            if b"Connection refused" not in done.stderr:
                break
            assert time.monotonic() < until, done.stderr
            time.sleep(0.05)
        out, _ = server.communicate(timeout=PATIENCE_S)  # the server ends with its one connection
        return out, done.stderr
    finally:
        server.kill()
        server.wait()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl")
def test_a_key_fetched_at_both_sites_is_tls_1_3s_external_psk_and_no_other_is(
    sites: Sites,
) -> None:
    sites.add_block(8)
    one, two = client(sites, "controller", "alice").enc_keys("bob", 2)
    (same,) = client(sites, "plant", "bob").dec_keys("alice", [one.key_id])
    assert tls_with(same.key, one.key, one.key_id)[0] == b"The old mill, at nine.\n"
    out, error = tls_with(same.key, two.key, one.key_id)
    assert out == b""
    assert b"alert" in error


# --- WireGuard ------------------------------------------------------------------------------------

WIREGUARD = ("wg", "wireguard-go", "ip", "ping")


def sh(*command: str, text: str = "") -> str:
    return subprocess.run(
        command, input=text, check=True, capture_output=True, text=True, timeout=PATIENCE_S
    ).stdout.strip()


class Tunnel:
    """Two network namespaces, a cable, and WireGuard in user space at both ends of it."""

    def __init__(self, folder: Path) -> None:
        self.names = [f"wg{side}{os.getpid()}" for side in "ab"]
        self.publics: list[str] = []
        self.folder = folder

    def inside(self, end: int, *command: str, text: str = "") -> str:
        return sh("ip", "netns", "exec", self.names[end], *command, text=text)

    def up(self) -> None:
        for name in self.names:
            sh("ip", "netns", "add", name)
        one, two = (f"c{name}" for name in self.names)
        sh("ip", "link", "add", one, "type", "veth", "peer", "name", two)
        for end, cable in enumerate((one, two)):
            sh("ip", "link", "set", cable, "netns", self.names[end])
            self.inside(end, "ip", "addr", "add", f"10.232.1.{end + 1}/24", "dev", cable)
            self.inside(end, "ip", "link", "set", cable, "up")
            self.inside(end, "wireguard-go", self.names[end])
            private = self.folder / f"private{end}"
            private.write_text(sh("wg", "genkey") + "\n")
            self.inside(end, "wg", "set", self.names[end], "listen-port", "51820",
                        "private-key", str(private))  # fmt: skip
            self.inside(end, "ip", "addr", "add", f"10.232.2.{end + 1}/24", "dev", self.names[end])
            self.inside(end, "ip", "link", "set", self.names[end], "up")
            self.publics.append(sh("wg", "pubkey", text=private.read_text()))
        for end in (0, 1):
            self.peer(end)

    def peer(self, end: int) -> None:
        """Make the other end known anew, so that nothing but a handshake leads to it."""
        other = self.publics[1 - end]
        self.inside(end, "wg", "set", self.names[end], "peer", other, "remove")
        self.inside(end, "wg", "set", self.names[end], "peer", other, "allowed-ips",
                    f"10.232.2.{2 - end}/32", "endpoint", f"10.232.1.{2 - end}:51820")  # fmt: skip

    def preshare(self, end: int) -> str:
        """The recipe's command: the key comes on standard input."""
        other = self.publics[1 - end]
        return (
            f"ip netns exec {self.names[end]} wg set {self.names[end]} peer {other} "
            "preshared-key /dev/stdin"
        )

    def passes(self) -> bool:
        try:
            self.inside(0, "ping", "-c", "3", "-i", "0.2", "-w", "3", "10.232.2.2")
        except subprocess.CalledProcessError:
            return False
        return True

    def down(self) -> None:
        for name in self.names:
            # a control socket that is gone ends its wireguard-go
            Path(f"/var/run/wireguard/{name}.sock").unlink(missing_ok=True)
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@pytest.mark.long
@pytest.mark.skipif(
    os.geteuid() != 0 or any(shutil.which(name) is None for name in WIREGUARD),
    reason="needs root, wireguard-tools, wireguard-go, ip and ping",
)
def test_wireguard_takes_a_rotated_key_at_both_ends_and_refuses_two_different_ones(
    ends: Ends, tmp_path: Path
) -> None:
    tunnel = Tunnel(tmp_path)
    try:
        try:
            tunnel.up()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no tunnel here: {error.stderr.strip()[-200:]}")
        ends.start("bob", "--run", tunnel.preshare(1))
        ends.start("alice", "--every", "3", "--run", tunnel.preshare(0))
        ends.until("alice", "in use", 2)
        shown = [tunnel.inside(e, "wg", "show", tunnel.names[e], "preshared-keys") for e in (0, 1)]
        keys = [base64.b64decode(line.split()[1]) for line in shown]
        assert keys[0] == keys[1]
        assert len(keys[0]) == 32
        assert tunnel.passes()
        # the control: one end has another key, and no handshake comes about
        for end in (0, 1):
            tunnel.peer(end)
        assert tunnel.passes()  # without any
        tunnel.peer(0)
        tunnel.peer(1)
        psk = base64.b64encode(bytes(32 * [7])).decode()
        sh(*tunnel.preshare(0).split(), text=psk + "\n")
        assert not tunnel.passes()
    finally:
        tunnel.down()
