"""The field bus through a router: who may publish what is decided by certificates."""

import json
import subprocess
import time

import pytest

from tests.compose.composition import (
    PATIENCE_S,
    Beside,
    Composition,
    all_healthy,
    arrives,
    under_way,
)

SERVICES = ("router", "secure-controller", "secure-plant", "secure-tap")
ROUTER = "tls/router.field:7447"

OPEN = """
import json, sys, time
from pathlib import Path
from runtime.addresses import TlsFiles
from runtime.zenoh_bus import ZenohBus
folder, *task = json.loads(sys.argv[1])
with ZenohBus(
    connect=["tls/router.field:7447"], client=True, tls=TlsFiles.in_folder(Path(folder))
) as bus:
"""

PUBLISH = (
    OPEN
    + """
    publishers = [(bus.publisher(key), payload.encode()) for key, payload in task]
    time.sleep(1)
    for _ in range(20):
        for publisher, payload in publishers:
            publisher.put(payload)
        time.sleep(0.05)
    time.sleep(0.5)
"""
)

WITNESS = (
    OPEN
    + """
    heard = {key: set() for key in task}
    for key in task:
        bus.subscribe(key, lambda key, payload, t_ns: heard[key].add(payload.decode()))
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps({key: sorted(said) for key, said in heard.items()}))
"""
)


def certificates(name: str) -> str:
    return f"/var/lib/wyner/certs/{name}"


def publish(system: Composition, name: str, *puts: tuple[str, str]) -> None:
    """Publish from a service's container, under that service's certificate."""
    system.python(f"secure-{name}", PUBLISH, json.dumps([certificates(name), *puts]))


def test_the_message_arrives_through_the_router(secure: Composition) -> None:
    all_healthy(secure, SERVICES)
    arrives(secure, "secure-plant", "at noon")


def test_the_router_passes_on_what_names_allow_and_drops_the_rest(secure: Composition) -> None:
    """All three publish everything, on a loop of this test's own; a witness listens."""
    all_healthy(secure, SERVICES)
    offer, measurement = "wyner/v2/witness/offer", "wyner/v2/witness/measurement"
    task = json.dumps([certificates("plant"), offer, measurement])
    witness = Beside(secure, "secure-plant", WITNESS, task)
    for name in ("tap", "controller", "plant"):
        publish(secure, name, (offer, f"from {name}"), (measurement, f"from {name}"))
    assert witness.enough() == {offer: ["from controller"], measurement: ["from plant"]}


def test_a_certificate_of_another_authority_opens_nothing(secure: Composition) -> None:
    all_healthy(secure, SERVICES)
    secure.execute("secure-tap", "wyner", "certs", "/tmp/other", "--name", "controller")

    def attempt(folder: str, within_s: float) -> subprocess.CompletedProcess[str]:
        program = ("python", "-c", OPEN + "    print('open')", json.dumps([folder]))
        return secure.execute("secure-tap", "timeout", f"{within_s:.0f}", *program, check=False)

    began = time.monotonic()
    own = attempt(certificates("tap"), PATIENCE_S)
    assert own.stdout == "open\n"
    other = attempt("/tmp/other/controller", 5 + 5 * (time.monotonic() - began))
    assert (other.returncode, other.stdout) == (124, "")


@pytest.mark.parametrize(
    ("service", "text"), [("router", "router dies"), ("secure-controller", "sender dies")]
)
def test_the_loop_outlives_the_death_of(secure: Composition, service: str, text: str) -> None:
    all_healthy(secure, SERVICES)
    under_way(secure, text, "secure-controller")
    secure.kill(service)
    arrives(secure, "secure-plant", text)
