"""`wyner kme`: two entities over mutual TLS, by our own eyes and by clients of other people's."""

import base64
import http.client
import json
import re
import select
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import pytest

from runtime.keys.store import KeyStore
from runtime.run_folder import CONTROLLER_KEYS
from tests.support.giving import agree
from tests.support.key_sites import KEYS, PAIRS, SIDES, Sites
from tests.support.patience import PATIENCE_S
from wyner.cli.main import main
from wyner.kme.entity import KeyManagementEntity, Names
from wyner.kme.identity import common_name
from wyner.kme.server import IDLE_S, KeyServer

pytest.importorskip("aiohttp")


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sites]:
    two = Sites(tmp_path_factory.mktemp("kme"))
    try:
        for side in SIDES:
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


def test_each_pair_has_a_share_of_its_own(sites: Sites) -> None:
    sites.add_block(16)
    _, told = sites.ask("controller", "carol", "/api/v1/keys/dave/enc_keys?number=2")
    ids = json.dumps({"key_IDs": [{"key_ID": k["key_ID"]} for k in told["keys"]]}).encode()
    code, error = sites.ask("plant", "bob", "/api/v1/keys/alice/dec_keys", ids)
    assert (code, error["message"]) == (401, "2 keys are not for SAE 'bob'")
    assert len(error["details"]) == 2
    code, got = sites.ask("plant", "dave", "/api/v1/keys/carol/dec_keys", ids)
    assert (code, got["keys"]) == (200, told["keys"])
    code, error = sites.ask("controller", "carol", "/api/v1/keys/bob/enc_keys")
    assert (code, error["message"]) == (400, "slave_SAE_ID: got 'bob', expected 'dave'")
    before = [
        sites.ask("controller", name, f"/api/v1/keys/{other}/status")[1]["stored_key_count"]
        for name, other in PAIRS
    ]
    assert sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")[0] == 200
    code, told = sites.ask("controller", "carol", "/api/v1/keys/dave/status")
    assert told["stored_key_count"] == before[1]
    assert sum(before) == 1 + sum(
        sites.ask("controller", name, f"/api/v1/keys/{other}/status")[1]["stored_key_count"]
        for name, other in PAIRS
    )


def test_it_tells_of_itself(sites: Sites, capsys: pytest.CaptureFixture[str]) -> None:
    run_dir = sites.folder / "plant"
    assert main(["status", str(run_dir), "--healthy", "kme-plant"]) == 0
    told = capsys.readouterr().out
    assert re.match(r"kme-plant advances: ok: \d+ keys ready for bob with alice, \d+ keys", told)
    assert main(["status", str(run_dir), "--healthy", "kme-controller"]) == 1


@pytest.mark.slow
def test_silent_connections_by_the_hundred_hold_nobody_up(sites: Sites) -> None:
    address = ("127.0.0.1", sites.ports["plant"])
    alone_s = seconds_for_a_status(sites)
    silent = [socket.create_connection(address) for _ in range(250)]
    begin = time.monotonic()
    assert sites.ask("plant", "bob", "/api/v1/keys/alice/status")[0] == 200
    assert time.monotonic() - begin < soon_s(alone_s)
    for connection in silent:
        connection.close()


@pytest.mark.slow
def test_one_callers_haste_is_not_the_others_loss(tmp_path: Path) -> None:
    two = Sites(tmp_path)
    try:
        two.start("controller", "--rate", "2")
        paths = {"alice": "/api/v1/keys/bob/status", "carol": "/api/v1/keys/dave/status"}
        codes = [two.ask("controller", "alice", paths["alice"])[0] for _ in range(12)]
        assert codes[:4] == [200] * 4
        assert 503 in codes
        assert two.ask("controller", "carol", paths["carol"])[0] == 200
    finally:
        two.stop()


def test_optional_extensions_are_passed_over(sites: Sites) -> None:
    body = json.dumps({"number": 1, "extension_optional": [{"a": 1}], "colour": "red"}).encode()
    assert sites.ask("controller", "alice", "/api/v1/keys/bob/enc_keys", body)[0] == 200


@pytest.mark.slow
def test_slow_and_silent_clients_hold_nobody_up(sites: Sites) -> None:
    alone_s = seconds_for_a_status(sites)
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
    assert time.monotonic() - begin < soon_s(alone_s)
    slow.settimeout(PATIENCE_S)
    answer = slow.recv(65536)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert time.monotonic() - begin > 4
    for connection in (slow, silent):
        connection.close()


def connected(sites: Sites, name: str) -> ssl.SSLSocket:
    plain = socket.socket()
    plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    plain.connect(("127.0.0.1", sites.ports["controller"]))
    return sites.tls(name).wrap_socket(plain, server_hostname="localhost")


def seconds_for_a_status(sites: Sites) -> float:
    begin = time.monotonic()
    assert sites.ask("controller", "carol", "/api/v1/keys/dave/status")[0] == 200
    return time.monotonic() - begin


def soon_s(alone_s: float) -> float:
    """What an answer may take, by what one took beside nothing: a machine may be slow."""
    return max(3.0, 10 * alone_s)


def closed_within(line: ssl.SSLSocket, seconds: float) -> bool:
    """Whether the other end lets go of a connection from which nothing is read."""
    watched = select.poll()
    watched.register(line.fileno(), 0)
    return bool(watched.poll(1000 * seconds))


REQUEST = b"GET /api/v1/keys/bob/status HTTP/1.1\r\nHost: x\r\n\r\n"


@pytest.mark.long
def test_one_who_asks_and_never_reads_is_held_back_and_let_go_of(sites: Sites) -> None:
    """Tens of thousands of requests in one connection: the server reads no more than it answers."""
    process = Path(f"/proc/{sites.processes['controller'].pid}/status")

    def resident_kib() -> int:
        lines = process.read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))

    before, alone_s = resident_kib(), seconds_for_a_status(sites)
    with connected(sites, "alice") as line:
        line.settimeout(1.0)
        sent = 0
        with pytest.raises(TimeoutError):
            while sent < 2**30:
                line.sendall(100 * REQUEST)
                sent += 100 * len(REQUEST)
        assert seconds_for_a_status(sites) < soon_s(alone_s)
        assert resident_kib() - before < 16 * 1024
        assert closed_within(line, PATIENCE_S)
    assert seconds_for_a_status(sites) < soon_s(alone_s)


@pytest.mark.long
def test_a_byte_at_a_time_is_served_in_time_and_let_go_of_after_it(sites: Sites) -> None:
    alone_s = seconds_for_a_status(sites)
    with connected(sites, "alice") as slow, connected(sites, "alice") as slower:
        slow.settimeout(PATIENCE_S)
        slower.settimeout(1)
        begin = time.monotonic()
        for place in range(len(REQUEST)):
            slow.sendall(REQUEST[place : place + 1])
            slower.sendall(REQUEST[place // 10 : place // 10 + 1] if place % 10 == 0 else b"")
            time.sleep(0.04)
        assert seconds_for_a_status(sites) < soon_s(alone_s)
        assert slow.recv(65536).startswith(b"HTTP/1.1 200 ")
        with suppress(OSError):
            for place in range(6, len(REQUEST)):
                slower.sendall(REQUEST[place : place + 1])
                if closed_within(slower, 1.0):
                    break
        assert IDLE_S - 1 < time.monotonic() - begin < IDLE_S + 15


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


@pytest.mark.long
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


@pytest.mark.long
def test_without_the_services_no_key_is_given_and_none_is_lost(tmp_path: Path) -> None:
    one = Sites(tmp_path, keys=8)
    one.end_services()
    try:
        one.start("controller")
        for _ in range(2):
            code, told = one.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")
            assert (code, told["message"]) == (
                503,
                "no key: the other end has not agreed yet: keys are given while both ends' "
                "services run",
            )
        with ExitStack() as opened:
            stores = [opened.enter_context(closing(one.store(side))) for side in SIDES]
            ((first, *_),) = [stores[0].ids()]
            agree(*stores)
        code, told = one.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")
        assert (code, [key["key_ID"] for key in told["keys"]]) == (200, [first[0]])
    finally:
        one.stop()


@pytest.mark.slow
def test_a_server_whose_store_is_put_back_under_it_ends_with_a_line(tmp_path: Path) -> None:
    one = Sites(tmp_path, keys=8)
    one.end_services()
    command = [sys.executable, "-m", "wyner", *one.command("controller")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        assert " serves alice " in server.stderr.readline()
        folder = (one.run_dir("controller") / CONTROLLER_KEYS).parent
        folder.rename(folder.with_name("before"))
        shutil.copytree(folder.with_name("before"), folder)
        told = server.stderr.read()
    assert server.returncode == 1
    assert told.endswith("it is gone, or another one is in its place: start again\n")
    assert told.count("\n") == 1


@pytest.mark.long
def test_where_its_health_line_cannot_be_written_it_gives_keys_all_the_same(
    tmp_path: Path,
) -> None:
    one = Sites(tmp_path, keys=8)
    (one.run_dir("controller") / "kme-controller").write_bytes(b"in the way")
    try:
        one.start("controller")
        time.sleep(1.2)  # until it tells of itself again
        assert one.ask("controller", "alice", "/api/v1/keys/bob/enc_keys")[0] == 200
        one.end_services()
        with closing(one.store("controller")) as store:
            store.db.execute("DROP TABLE key")
        for path in ("status", "enc_keys"):
            code, told = one.ask("controller", "alice", f"/api/v1/keys/bob/{path}")
            assert (code, told["message"][:7]) == (503, "no key:")
        one.processes["controller"].send_signal(signal.SIGTERM)
        assert one.processes["controller"].wait(PATIENCE_S) == 0
    finally:
        one.stop()


@pytest.mark.slow
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
        assert two.processes["controller"].wait(PATIENCE_S) == 0
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


# --- parts ----------------------------------------------------------------------------------------


def test_an_allowance_fills_up_again() -> None:
    entity = KeyManagementEntity(Names("kme-plant", "kme-controller", ()), KeyStore(None, "plant"))
    allowed = KeyServer(entity, 2.0).allowed
    assert [allowed["a"].allows(0.0) for _ in range(5)] == [True] * 4 + [False]
    assert allowed["b"].allows(0.0)
    assert allowed["a"].allows(0.5)
    assert not allowed["a"].allows(0.5)


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
        (["--sae", "c", "--partner-sae", "c"], "--partner-sae: got 'c' twice, expected another"),
        (["--sae", "a", "--partner-sae", "b"], "--partner-sae: got 'b' twice, expected another"),
        (["--sae", "c"], "--partner-sae: got 1, expected one for each of 2 --sae"),
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
