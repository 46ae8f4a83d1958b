"""The router: what its access rules say, and what a real one does with them on loopback."""

import contextlib
import queue
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from protocol.messages import ADVERSARY, FIELD, MANAGEMENT, Measurement, Offer
from protocol.topics import key_of
from runtime.addresses import TlsFiles, free_endpoints
from runtime.bus import Deliver
from runtime.services import BUSES, SERVICES, on_bus
from runtime.zenoh_bus import ZenohBus, open_router
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.traces import recovered_in
from wyner.deployment.access import access_control
from wyner.deployment.certificates import ensure_certificates

# --- the rules ------------------------------------------------------------------------------------


TYPES = {"field": FIELD, "management": MANAGEMENT, "adversary": ADVERSARY}


def publishers(bus: str, topic: str) -> list[str]:
    return [row.name for row in on_bus(bus) if topic in row.publishes.get(bus, ())]


def test_every_message_type_has_one_bus_and_one_publisher_who_may_also_read_there() -> None:
    topics = {bus: {t.topic for t in types} for bus, types in TYPES.items()}
    for bus, theirs in topics.items():
        assert {t for row in on_bus(bus) for t in row.publishes.get(bus, ())} == theirs
        assert all(len(publishers(bus, topic)) == 1 for topic in theirs)
    for row in (SERVICES[name] for name in SERVICES):
        assert set(row.publishes) <= set(row.ends)


@pytest.mark.parametrize("bus", BUSES)
def test_only_the_publisher_of_a_type_may_put_it(bus: str) -> None:
    table = access_control(bus)
    rules = {rule["id"]: rule for rule in table["rules"]}
    may_put: dict[str, set[str]] = {}
    for policy in table["policies"]:
        for rule in (rules[name] for name in policy["rules"]):
            if "ingress" in rule["flows"] and "put" in rule["messages"]:
                for key in rule["key_exprs"]:
                    may_put.setdefault(key, set()).update(policy["subjects"])
    assert may_put == {
        key_of(t, "loop").replace("/loop/", "/*/"): set(publishers(bus, t.topic))
        for t in TYPES[bus]
    }


# --- a real router --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("certs")
    hosts = ["localhost", "127.0.0.1"]
    ensure_certificates(
        folder, dict.fromkeys(("router", "controller", "plant", "tap", "stranger"), hosts), 2
    )
    return folder


@contextlib.contextmanager
def clients(certs: Path, endpoint: str, *names: str) -> Iterator[dict[str, ZenohBus]]:
    with contextlib.ExitStack() as stack:
        yield {
            name: stack.enter_context(
                ZenohBus(connect=[endpoint], client=True, tls=TlsFiles.in_folder(certs / name))
            )
            for name in names
        }


@pytest.mark.integration
def test_a_guarded_router_passes_on_what_the_names_allow_and_nothing_else(certs: Path) -> None:
    endpoint = free_endpoints(1)[0].replace("tcp/", "tls/")
    names = ("controller", "plant", "tap", "stranger")
    keys = [key_of(t, "loop") for t in (Measurement, Offer)]
    heard: queue.SimpleQueue[tuple[str, str, str]] = queue.SimpleQueue()

    def listener(who: str) -> Deliver:
        return lambda key, payload, _t_ns: heard.put((who, key, payload.decode()))

    tls = TlsFiles.in_folder(certs / "router")
    with (
        open_router([endpoint], tls, access_control("field")),
        clients(certs, endpoint, *names) as buses,
    ):
        for name, bus in buses.items():
            for key in keys:
                bus.subscribe(key, listener(name))
        publishers = {(name, key): buses[name].publisher(key) for name in names for key in keys}
        measurement, offer = keys
        allowed = {
            ("controller", measurement, "from plant"),
            ("plant", offer, "from controller"),
            ("tap", measurement, "from plant"),
            ("tap", offer, "from controller"),
        }
        got: set[tuple[str, str, str]] = set()

        def all_came() -> bool:
            for (name, _key), publisher in publishers.items():
                publisher.put(f"from {name}".encode())
            time.sleep(0.1)
            while not heard.empty():
                got.add(heard.get())
            return got >= allowed

        for _ in range(3):  # what is forged has three times as long to come
            wait_for(all_came)
    assert got == allowed


def wyner(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "wyner.cli.main", *arguments]


@pytest.mark.long
@pytest.mark.integration
def test_the_whole_system_runs_through_guarded_routers(tmp_path: Path) -> None:
    """All three buses under mutual TLS, as docs/deployment.md sets up several machines."""
    certs = tmp_path / "certs"
    subprocess.run(wyner("certs", str(certs)), check=True, capture_output=True, timeout=PATIENCE_S)
    at = dict(zip(BUSES, (e.replace("tcp/", "tls/") for e in free_endpoints(3)), strict=True))

    def through_router(name: str, *buses: str) -> list[str]:
        options = []
        for bus in buses:
            options += ["--client", bus, "--connect", f"{bus}={at[bus]}"]
            options += ["--tls", f"{bus}={certs / name}"]
        return options

    router = []
    for bus in BUSES:
        router += ["--listen", f"{bus}={at[bus]}", "--tls", f"{bus}={certs / 'router'}"]
    plant = ["--pace", "fast", *through_router("plant", "field", "management")]
    commands = {
        "router": router,
        "plant": ["--run-dir", str(tmp_path), *plant],
        "controller": [
            "--run-dir",
            str(tmp_path),
            *through_router("controller", "field", "management"),
        ],
    }

    def send(text: str, name: str, timeout_s: str) -> int:
        command = wyner("send", text, "--timeout", timeout_s, *through_router(name, "management"))
        return subprocess.run(
            command, capture_output=True, timeout=PATIENCE_S, check=False
        ).returncode

    running = [subprocess.Popen(wyner(name, *rest)) for name, rest in commands.items()]
    try:
        assert send("by the operator", "operator", f"{PATIENCE_S - 60:.0f}") == 0
        assert send("by somebody who may only look", "dashboard", "2") == 1
        recovered = partial(recovered_in, tmp_path)
        wait_for(recovered)
        assert recovered() == [b"by the operator"]
        for process in reversed(running):
            process.terminate()
            assert process.wait(PATIENCE_S) == 0
    finally:
        for process in running:
            if process.poll() is None:
                process.kill()
            process.wait()
