"""Two sites with a key server each, over stores that hold the same keys."""

import http.client
import json
import secrets
import socket
import ssl
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

from protocol.secret.records import BlockRow, StoreError
from runtime.addresses import free_endpoints
from runtime.keys.store import KeyStore
from runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS
from tests.support.giving import agree
from tests.support.patience import PATIENCE_S
from wyner.deployment.certificates import ensure_certificates

KEYS = 60
SIDES = ("controller", "plant")
PAIRS = (("alice", "bob"), ("carol", "dave"))
"""Applications at the controller's site and at the plant's."""

APPLICATIONS = ("alice", "bob", "carol", "dave", "mallory")
Answer = tuple[int, dict[str, Any]]


def free_port() -> int:
    return int(free_endpoints(1)[0].rpartition(":")[2])


class Sites:
    """Two run folders with the same keys, an entity at each, certificates for everybody."""

    def __init__(self, folder: Path, keys: int = KEYS) -> None:
        self.folder = folder
        hosts = ["localhost", "127.0.0.1"]
        names = ("kme-controller", "kme-plant", *APPLICATIONS)
        ensure_certificates(folder / "certs", dict.fromkeys(names, hosts), 2)
        self.ports = {side: free_port() for side in SIDES}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.blocks = 0
        self._over = threading.Event()
        self._meeting = threading.Lock()  # each meeting is a start, and what one end lacks is lost
        self._services = threading.Thread(target=self._agree, daemon=True)
        if keys:
            self.add_block(keys)
            self._services.start()

    def _agree(self) -> None:
        """What the services of both ends do for their key servers."""
        while not self._over.wait(0.1):
            with self._meeting, suppress(StoreError), ExitStack() as opened:
                agree(*(opened.enter_context(self.store(side)) for side in SIDES))

    def run_dir(self, side: str) -> Path:
        """The run whose keys an entity serves."""
        return self.folder / side

    def store(self, side: str) -> KeyStore:
        path = self.run_dir(side) / (CONTROLLER_KEYS if side == "controller" else PLANT_KEYS)
        return KeyStore(path, "controller" if side == "controller" else "plant", create=True)

    def add_block(self, keys: int) -> None:
        bodies = [secrets.token_bytes(32) for _ in range(keys)]
        row = BlockRow("s", self.blocks, 256, 256, 512, keys + 1, keys, "stored", 1)
        self.blocks += 1
        with self._meeting:
            for side in SIDES:
                with closing(self.store(side)) as store:
                    store.add(row, bodies, tag="t")
                    store.confirm("s", row.number)
                    store.set_note("assumption", "misses 30 %")

    def command(self, side: str) -> list[str]:
        """The command that starts an entity, without ``wyner``."""
        pairs = [(one, two) if side == "controller" else (two, one) for one, two in PAIRS]
        named = [text for a, b in pairs for text in (f"--sae={a}", f"--partner-sae={b}")]
        return [
            "kme",
            "--side",
            side,
            "--run-dir",
            str(self.run_dir(side)),
            *named,
            "--tls",
            str(self.folder / "certs" / f"kme-{side}"),
            "--listen",
            f"127.0.0.1:{self.ports[side]}",
        ]

    def start(self, side: str, *more: str) -> None:
        process = subprocess.Popen(
            [sys.executable, "-m", "wyner", *self.command(side), *more],
            stderr=subprocess.DEVNULL,
        )
        self.processes[side] = process
        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.ports[side]), 0.2).close()
                return
            except OSError:
                assert process.poll() is None
                assert time.monotonic() < until
                time.sleep(0.02)

    def end_services(self) -> None:
        """The ends' services are gone: nobody asks the other end."""
        self._over.set()
        if self._services.is_alive():
            self._services.join()

    def stop(self) -> None:
        self.end_services()
        for process in self.processes.values():
            process.kill()
            process.wait()

    def tls(self, name: str | None) -> ssl.SSLContext:
        certs = self.folder / "certs"
        context = ssl.create_default_context(cafile=str(certs / "ca.pem"))
        if name is not None:
            context.load_cert_chain(certs / name / "cert.pem", certs / name / "key.pem")
        return context

    def ask(
        self, side: str, name: str, path: str, body: bytes | None = None, method: str = ""
    ) -> Answer:
        connection = http.client.HTTPSConnection(
            "localhost", self.ports[side], context=self.tls(name), timeout=PATIENCE_S
        )
        with closing(connection):
            connection.request(method or ("GET" if body is None else "POST"), path, body)
            answer = connection.getresponse()
            assert answer.getheader("Content-Type") == "application/json; charset=utf-8"
            return answer.status, json.loads(answer.read())
