"""The field bus through a router: who may publish what is decided by certificates."""

import json
import subprocess
import time

import pytest

from tests.compose.composition import PATIENCE_S, Composition, all_healthy, arrives, wait_for

SERVICES = ("router", "secure-controller", "secure-plant", "secure-tap")
ROUTER = "tls/router.field:7447"

OPEN = """
import json, sys, time
from pathlib import Path
from protocol.runtime.endpoints import TlsFiles
from protocol.runtime.zenoh_bus import ZenohBus
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
    print("listening", flush=True)
    sys.stdin.readline()
    print(json.dumps({key: sorted(said) for key, said in heard.items()}))
"""
)


def certificates(name: str) -> str:
    return f"/var/lib/wyner/certs/{name}"


def publish(system: Composition, name: str, *puts: tuple[str, str]) -> None:
    """Publish from a service's container, under that service's certificate."""
    system.python(f"secure-{name}", PUBLISH, json.dumps([certificates(name), *puts]))


class Witness:
    """Somebody who listens under the plant's certificate, in the plant's container."""

    def __init__(self, system: Composition, *keys: str) -> None:
        task = json.dumps([certificates("plant"), *keys])
        self._process = subprocess.Popen(
            [
                "docker",
                "exec",
                "-i",
                system.container("secure-plant"),
                "python",
                "-c",
                WITNESS,
                task,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "listening\n"

    def heard(self) -> dict[str, list[str]]:
        said, _ = self._process.communicate("enough\n", timeout=30)
        found: dict[str, list[str]] = json.loads(said)
        return found


def test_the_message_arrives_through_the_router(secure: Composition) -> None:
    all_healthy(secure, SERVICES)
    arrives(secure, "secure-plant", "at noon")


def test_each_container_holds_one_identity_and_no_authority(secure: Composition) -> None:
    for service in SERVICES:
        own = service.removeprefix("secure-")
        keys = secure.execute(service, "find", "/var/lib/wyner/certs", "-name", "*key.pem")
        assert keys.stdout.split() == [f"{certificates(own)}/key.pem"]


def test_the_router_passes_on_what_names_allow_and_drops_the_rest(secure: Composition) -> None:
    """All three publish everything, on a loop of this test's own; a witness listens."""
    all_healthy(secure, SERVICES)
    offer, measurement = "wyner/v1/witness/offer", "wyner/v1/witness/measurement"
    witness = Witness(secure, offer, measurement)
    for name in ("tap", "controller", "plant"):
        publish(secure, name, (offer, f"from {name}"), (measurement, f"from {name}"))
    assert witness.heard() == {offer: ["from controller"], measurement: ["from plant"]}


def test_forged_publications_from_the_tap_change_nothing(secure: Composition) -> None:
    """On the live loop, while a message is on its way. (test_direct.py shows them arriving.)"""
    all_healthy(secure, SERVICES)
    secure.send("she forges")
    publish(
        secure,
        "tap",
        ("wyner/v1/loop/offer", "forged"),
        ("wyner/v1/loop/measurement", "forged"),
    )
    arrives(secure, "secure-plant", "she forges")
    assert secure.status("secure-plant", "plant")["garbage"] == 0
    assert secure.status("secure-controller", "controller")["garbage"] == 0


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


@pytest.mark.parametrize("service", ["router", "secure-controller"])
def test_the_loop_outlives_the_death_of(secure: Composition, service: str) -> None:
    all_healthy(secure, SERVICES)
    text = f"{service} dies midway"
    secure.send(text)
    wait_for(
        lambda: (
            (s := secure.status("secure-controller", "controller"))["frame_symbols"]
            < s["frame_length"]
        ),
        "message under way",
    )
    secure.kill(service)
    arrives(secure, "secure-plant", text)
