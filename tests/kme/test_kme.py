"""`wyner kme`: two entities over mutual TLS, by our own eyes and by clients of other people's."""

import base64
import http.client
import json
import secrets
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from protocol.runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS
from protocol.secret.records import BlockRow
from protocol.secret.store import KeyStore
from wyner.cli.main import main
from wyner.deployment.certificates import ensure_certificates
from wyner.kme.server import Allowance, common_name

pytest.importorskip("aiohttp")

KEYS = 60
SITES = {"controller": ("alice", "bob"), "plant": ("bob", "alice")}
Answer = tuple[int, dict[str, Any]]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


class Sites:
    """Two run folders with the same keys, an entity at each, certificates for everybody."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        hosts = ["localhost", "127.0.0.1"]
        names = ("kme-controller", "kme-plant", "alice", "bob", "mallory")
        ensure_certificates(folder / "certs", dict.fromkeys(names, hosts), 2)
        self.ports = {side: free_port() for side in SITES}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.blocks = 0
        self.add_block(KEYS)

    def store(self, side: str) -> KeyStore:
        path = self.folder / side / (CONTROLLER_KEYS if side == "controller" else PLANT_KEYS)
        return KeyStore(path, "controller" if side == "controller" else "plant", create=True)

    def add_block(self, keys: int) -> None:
        bodies = [secrets.token_bytes(32) for _ in range(keys)]
        row = BlockRow("s", self.blocks, 256, 256, 512, keys + 1, keys, "stored", 1)
        self.blocks += 1
        for side in SITES:
            with closing(self.store(side)) as store:
                store.add(row, bodies, tag="t")
                store.confirm("s", row.number)
                store.set_note("assumption", "misses 30 %")

    def start(self, side: str, *more: str) -> None:
        sae, partner = SITES[side]
        process = subprocess.Popen(
            [
                *(sys.executable, "-m", "wyner", "kme", "--side", side),
                *("--run-dir", str(self.folder / side), "--sae", sae, "--partner-sae", partner),
                *("--tls", str(self.folder / "certs" / f"kme-{side}")),
                *("--listen", f"127.0.0.1:{self.ports[side]}", *more),
            ],
            stderr=subprocess.DEVNULL,
        )
        self.processes[side] = process
        until = time.monotonic() + 20
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.ports[side]), 0.2).close()
                return
            except OSError:
                assert process.poll() is None
                assert time.monotonic() < until
                time.sleep(0.02)

    def stop(self) -> None:
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
            "localhost", self.ports[side], context=self.tls(name), timeout=10
        )
        with closing(connection):
            connection.request(method or ("GET" if body is None else "POST"), path, body)
            answer = connection.getresponse()
            assert answer.getheader("Content-Type") == "application/json; charset=utf-8"
            return answer.status, json.loads(answer.read())


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sites]:
    two = Sites(tmp_path_factory.mktemp("kme"))
    try:
        for side in SITES:
            two.start(side)
        yield two
    finally:
        two.stop()


def test_both_sites_give_the_same_key_by_its_id_and_once(sites: Sites) -> None:
    code, told = sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys?number=2&size=256")
    assert code == 200
    assert set(told) == {"keys", "key_container_extension"}
    assert told["key_container_extension"] == {"assumption": "misses 30 %"}
    one, two = told["keys"]
    assert set(one) == {"key_ID", "key"}
    assert len(base64.b64decode(one["key"])) == 32
    named = json.dumps({"key_IDs": [{"key_ID": two["key_ID"]}, {"key_ID": one["key_ID"]}]}).encode()
    code, got = sites.ask("plant", "bob", "/api/v1/keys/alice/dec_keys", named)
    assert (code, got["keys"]) == (200, [two, one])
    code, error = sites.ask("plant", "bob", "/api/v1/keys/alice/dec_keys", named)
    assert (code, error["message"]) == (400, "one or more keys specified are not found on KME")
    assert {d["key_ID"] for d in error["details"]} == {one["key_ID"], two["key_ID"]}


def test_halves_are_disjoint(sites: Sites) -> None:
    """What bob gets as a master at his own site, alice finds by id at hers."""
    _, told = sites.ask("plant", "bob", "/api/v1/keys/alice/enc_keys")
    (key,) = told["keys"]
    path = f"/api/v1/keys/bob/dec_keys?key_ID={key['key_ID']}"
    assert sites.ask("controller", "alice", path)[1]["keys"] == [key]


def test_the_status_has_the_standards_fields(sites: Sites) -> None:
    code, told = sites.ask("controller", "alice", "/api/v1/keys/bob/status")
    assert code == 200
    left = told.pop("stored_key_count")
    assert 0 < left <= KEYS // 2
    assert told == {
        "source_KME_ID": "kme-controller",
        "target_KME_ID": "kme-plant",
        "master_SAE_ID": "alice",
        "slave_SAE_ID": "bob",
        "key_size": 256,
        "max_key_count": 100_000,
        "max_key_per_request": 32,
        "max_key_size": 256,
        "min_key_size": 256,
        "max_SAE_ID_count": 0,
        "status_extension": {"assumption": "misses 30 %"},
    }


@pytest.mark.parametrize(
    ("path", "body", "code", "message"),
    [
        ("bob/enc_keys?size=257", None, 400, "size shall be a multiple of 8"),
        ("bob/enc_keys?size=128", None, 400, "size: got 128, expected 256"),
        ("bob/enc_keys?number=0", None, 400, "number: got 0, expected 1 to 32"),
        ("bob/enc_keys?number=33", None, 400, "number: got 33"),
        ("bob/enc_keys?number=two", None, 400, "number: got 'two', expected a whole number"),
        ("bob/enc_keys", b"{", 400, "not a KeyRequest"),
        ("bob/enc_keys", b'{"number": "1"}', 400, "not a KeyRequest"),
        ("bob/enc_keys", b'{"number": 1e400}', 400, "not a KeyRequest"),
        (
            "bob/enc_keys",
            b'{"extension_mandatory": [{"a": 1}]}',
            400,
            "not all extension_mandatory parameters are supported",
        ),
        ("bob/enc_keys", b'{"additional_slave_SAE_IDs": ["c"]}', 400, "max_SAE_ID_count is 0"),
        ("carol/enc_keys", None, 400, "slave_SAE_ID: got 'carol', expected 'bob'"),
        ("carol/status", None, 400, "slave_SAE_ID: got 'carol'"),
        ("carol/dec_keys?key_ID=x", None, 400, "master_SAE_ID: got 'carol'"),
        ("bob/dec_keys", None, 400, "key_ID: got none"),
        ("bob/dec_keys", b'{"key_IDs": []}', 400, "not a KeyIds"),
        ("bob/dec_keys", b'{"key_IDs": "x"}', 400, "not a KeyIds"),
        ("bob/dec_keys?key_ID=x", None, 400, "one or more keys specified are not found on KME"),
        ("bob/other", None, 404, "Not Found"),
        ("bob/status", b"", 405, "Method Not Allowed"),
        ("bob/enc_keys", b" " * (64 * 1024 + 1), 413, "Request Entity Too Large"),
    ],
)
def test_what_cannot_be_asked_is_an_error_object(
    sites: Sites, path: str, body: bytes | None, code: int, message: str
) -> None:
    before = sites.ask("controller", "alice", "/api/v1/keys/bob/status")[1]["stored_key_count"]
    got, error = sites.ask("controller", "alice", f"/api/v1/keys/{path}", body)
    assert got == code
    assert message in error["message"]
    assert set(error) <= {"message", "details"}
    after = sites.ask("controller", "alice", "/api/v1/keys/bob/status")[1]["stored_key_count"]
    assert after == before


def test_others_get_nothing(sites: Sites) -> None:
    for path in ("bob/status", "bob/enc_keys", "bob/dec_keys?key_ID=x"):
        code, error = sites.ask("controller", "mallory", f"/api/v1/keys/{path}")
        assert (code, error["message"]) == (401, "SAE 'mallory': not served by kme-controller")
        assert sites.ask("controller", "bob", f"/api/v1/keys/{path}")[0] == 401
    with pytest.raises((ssl.SSLError, OSError)):
        sites.ask("controller", None, "/api/v1/keys/bob/status")  # type: ignore[arg-type]


def test_optional_extensions_are_passed_over(sites: Sites) -> None:
    body = json.dumps({"number": 1, "extension_optional": [{"a": 1}], "colour": "red"}).encode()
    assert sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys", body)[0] == 200


def test_slow_and_silent_clients_hold_nobody_up(sites: Sites) -> None:
    silent = socket.create_connection(("127.0.0.1", sites.ports["controller"]))
    slow = sites.tls("alice").wrap_socket(
        socket.create_connection(("127.0.0.1", sites.ports["controller"])),
        server_hostname="localhost",
    )
    slow.sendall(
        b"POST /api/v1/keys/bob/enc_keys HTTP/1.1\r\nHost: x\r\nContent-Length: 99\r\n\r\n{"
    )
    begin = time.monotonic()
    assert sites.ask("controller", "alice", "/api/v1/keys/bob/status")[0] == 200
    assert time.monotonic() - begin < 3
    slow.settimeout(15)
    answer = slow.recv(65536)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert time.monotonic() - begin > 4
    for connection in (slow, silent):
        connection.close()


def test_two_masters_at_once_never_get_one_key_twice(sites: Sites) -> None:
    sites.add_block(40)
    got: list[str] = []

    def fetch() -> None:
        for _ in range(5):
            code, told = sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys?number=2")
            assert code == 200
            got.extend(k["key_ID"] for k in told["keys"])

    threads = [threading.Thread(target=fetch) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(got)) == len(got) == 20


def test_killed_at_any_time_it_gives_no_key_twice_and_loses_few(sites: Sites) -> None:
    sites.add_block(80)
    got: dict[str, str] = {}
    for _ in range(3):
        stop = threading.Timer(0.25, sites.processes["controller"].kill)
        stop.start()
        try:
            while True:
                code, told = sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")
                if code == 503:
                    sites.add_block(40)
                    continue
                for key in told["keys"]:
                    assert key["key_ID"] not in got
                    got[key["key_ID"]] = key["key"]
        except (OSError, http.client.HTTPException):
            pass
        stop.join()
        sites.processes["controller"].wait()
        sites.start("controller")
    assert got
    for key_id, key in list(got.items())[::7]:
        code, told = sites.ask("plant", "bob", f"/api/v1/keys/alice/dec_keys?key_ID={key_id}")
        assert (code, told["keys"][0]["key"]) == (200, key)


def test_without_keys_or_with_refused_ones_it_says_503(tmp_path: Path) -> None:
    two = Sites(tmp_path)
    try:
        with closing(two.store("controller")) as store:
            store.refuse("the run is seeded")
        two.start("controller", "--rate", "1")
        code, error = two.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")
        assert (code, error["message"]) == (503, "no key: the run is seeded")
        assert two.ask("controller", "alice", "/api/v1/keys/bob/status")[1]["stored_key_count"] == 0
        code, error = two.ask("controller", "alice", "/api/v1/keys/bob/status")
        assert (code, error["message"]) == (503, "too many requests; ask again in a second")
        two.processes["controller"].send_signal(signal.SIGTERM)
        assert two.processes["controller"].wait(10) == 0
    finally:
        two.stop()


# --- other people's clients -----------------------------------------------------------------------


def test_qkdsecs_doctor_finds_nine_things_right_and_warns_of_its_own_error(sites: Sites) -> None:
    """Two sites: dec_keys is asked of the slave's entity, as the slave. It wants 404 for an
    unknown id where the standard says 400."""
    client = pytest.importorskip("qkdsec.client")
    doctor = pytest.importorskip("qkdsec.doctor")
    sites.add_block(20)
    certs = sites.folder / "certs"

    def of(side: str, name: str) -> dict[str, Any]:
        return {
            "base_url": f"https://localhost:{sites.ports[side]}",
            "client_cert": (str(certs / name / "cert.pem"), str(certs / name / "key.pem")),
            "verify": str(certs / "ca.pem"),
        }

    slave = client.ETSI014Client(**of("plant", "bob"))

    class TwoSites(client.ETSI014Client):  # type: ignore[misc,name-defined]
        def get_dec_keys(self, _slave: str, **more: Any) -> Any:
            return slave.get_dec_keys("alice", **more)

    with slave, TwoSites(**of("controller", "alice")) as master:
        report = doctor.run_all(master, "bob")
    found = {r.name: r.status.value for r in report.results}
    assert found.pop("error_contract_404") == "warn"
    assert set(found.values()) == {"pass"}
    assert len(found) == 9


def test_the_client_etsi_qkd_014_gets_keys(sites: Sites) -> None:
    module = pytest.importorskip("etsi_qkd_014_client")
    sites.add_block(8)

    def client(side: str, name: str) -> Any:
        folder = sites.folder / "certs" / name
        paths = (folder / "cert.pem", folder / "key.pem", folder / "ca.pem")
        return module.QKD014Client(f"localhost:{sites.ports[side]}", *map(str, paths))

    code, status = client("controller", "alice").get_status("bob")
    assert (code, status.source_kme_id) == (200, "kme-controller")
    code, told = client("controller", "alice").get_key("bob", number=1, size=256)
    assert code == 200
    (key,) = told.keys
    code, got = client("plant", "bob").get_key_with_key_IDs("alice", [key.key_id])
    assert (code, got.keys[0].key) == (200, key.key)
    code, _ = client("controller", "mallory").get_status("bob")
    assert code == 401


def test_a_key_fetched_at_both_sites_is_tls_1_3s_external_psk(sites: Sites) -> None:
    """The recipe of docs/keys.md: openssl at both ends, no certificate."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl")
    sites.add_block(8)
    _, told = sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")
    (mine,) = told["keys"]
    path = f"/api/v1/keys/alice/dec_keys?key_ID={mine['key_ID']}"
    (theirs,) = sites.ask("plant", "bob", path)[1]["keys"]
    port = free_port()
    common = ["-tls1_3", "-psk_identity", mine["key_ID"], "-psk"]
    server = subprocess.Popen(
        [
            *("openssl", "s_server", "-quiet", "-nocert", "-naccept", "1", "-port", str(port)),
            *(*common, base64.b64decode(theirs["key"]).hex()),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + 10
        while True:
            done = subprocess.run(
                [
                    *("openssl", "s_client", "-quiet", "-no_ign_eof"),
                    *("-connect", f"127.0.0.1:{port}"),
                    *(*common, base64.b64decode(mine["key"]).hex()),
                ],
                input=b"The old mill, at nine.\n",
                capture_output=True,
                timeout=10,
                check=False,
            )
            if done.returncode == 0:
                break
            assert time.monotonic() < until, done.stderr
            time.sleep(0.1)
        out, _ = server.communicate(timeout=10)  # the server ends with its one connection
        assert out == b"The old mill, at nine.\n"
    finally:
        server.kill()
        server.wait()


# --- parts ----------------------------------------------------------------------------------------


def test_an_allowance_fills_up_again() -> None:
    allowance = Allowance(2.0)
    assert [allowance.take("a", 0.0) for _ in range(5)] == [True] * 4 + [False]
    assert allowance.take("b", 0.0)
    assert allowance.take("a", 0.5)
    assert not allowance.take("a", 0.5)


def test_a_certificate_with_two_common_names_is_nobodys() -> None:
    one = ((("commonName", "alice"),),)
    assert common_name({"subject": one}) == "alice"
    assert common_name({"subject": (*one, (("commonName", "bob"),))}) is None
    assert common_name(None) is None


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (["--listen", "here"], "--listen: got 'here', expected HOST:PORT"),
        (["--rate", "0"], "--rate: got 0, expected more than 0"),
        (["--partner-sae", "a"], "--partner-sae: got 'a' twice, expected another"),
        ([], "--tls: none: No such file or directory"),
    ],
)
def test_wrong_use_is_one_line(
    changes: list[str],
    expected: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    use = [
        "--run-dir",
        "run",
        "--side",
        "plant",
        "--sae",
        "a",
        "--partner-sae",
        "b",
        "--tls",
        "none",
    ]
    assert main(["kme", *use, *changes]) == 2
    assert capsys.readouterr().err == f"wyner: {expected}\n"
    assert not list(tmp_path.iterdir())
