"""Three services, connected directly: what arrives, what may be reached, and from where."""

import json
import subprocess

import pytest

from tests.compose.composition import (
    RUN,
    Composition,
    all_healthy,
    arrives,
    docker,
)

SERVICES = ("controller", "plant", "tap")


def test_an_operators_message_arrives(direct: Composition) -> None:
    direct.send("hand: 50 °C")
    arrives(direct, "plant", "hand: 50 °C")


@pytest.mark.parametrize("service", SERVICES)
def test_no_service_has_rights_it_does_not_need(direct: Composition, service: str) -> None:
    settings = direct.inspect(service)
    assert settings["Config"]["User"] == "wyner"
    assert settings["HostConfig"]["ReadonlyRootfs"] is True
    assert settings["HostConfig"]["CapDrop"] == ["ALL"]
    assert settings["HostConfig"]["SecurityOpt"] == ["no-new-privileges:true"]
    assert settings["HostConfig"]["RestartPolicy"]["Name"] == "on-failure"
    status = direct.execute(service, "cat", "/proc/1/status").stdout
    granted = {line.split()[0]: line.split()[1] for line in status.splitlines() if "Cap" in line}
    assert set(granted.values()) == {"0" * 16}
    assert direct.execute(service, "touch", "/opt/wyner/x", check=False).returncode != 0


def test_nothing_is_published_to_the_machine(direct: Composition) -> None:
    for service in SERVICES:
        assert not direct.inspect(service)["HostConfig"]["PortBindings"]
    for bus in ("field", "management", "adversary"):
        network = json.loads(docker("network", "inspect", f"{direct.project}_{bus}"))[0]
        assert network["Internal"] is True


def test_the_tap_holds_no_scenario_journal_or_plaintext(direct: Composition) -> None:
    looked = direct.execute(
        "tap", "find", "/", "-xdev", "(", "-name", "*.toml", "-path", "*scenarios*", ")",
        "-o", "-name", "journal.sqlite3", check=False,
    )  # fmt: skip
    assert looked.stdout == ""
    mounted = {m["Destination"] for m in direct.inspect("tap")["Mounts"]}
    assert mounted == {RUN, "/var/lib/wyner/knowledge"}
    knowledge = json.loads(
        direct.execute("tap", "cat", "/var/lib/wyner/knowledge/knowledge.json").stdout
    )
    assert knowledge["alpha"] is None
    # D_e of the shipped scenario, and not D_c.
    assert knowledge["disturbance_h"] == [0.96] * 4


# --- networks -----------------------------------------------------------------------------------

CONNECT = """
import socket, sys
from concurrent.futures import ThreadPoolExecutor
def attempt(target):
    host, _, port = target.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except OSError as error:
        return f"{target} failed: {error}"
    return f"{target} connected"
with ThreadPoolExecutor() as pool:
    print(*pool.map(attempt, sys.argv[1:]), sep="\\n")
"""


def outcomes(run: "subprocess.CompletedProcess[str]") -> dict[str, bool]:
    return {line.split()[0]: line.endswith("connected") for line in run.stdout.splitlines()}


def address(system: Composition, service: str, bus: str) -> str:
    networks = system.inspect(service)["NetworkSettings"]["Networks"]
    return str(networks[f"{system.project}_{bus}"]["IPAddress"])


def test_the_tap_has_no_route_to_management(direct: Composition) -> None:
    all_healthy(direct, SERVICES)
    plant, controller = (address(direct, s, "management") for s in ("plant", "controller"))
    plant_field, controller_field = (address(direct, s, "field") for s in ("plant", "controller"))
    tried = outcomes(
        direct.python(
            "tap", CONNECT, "plant.management:7463", "controller.management:7464",
            f"{plant}:7463", f"{controller}:7464",
            # The same containers, by the address that the tap can reach: nobody listens there.
            f"{plant_field}:7463", f"{controller_field}:7464",
            # The control: what the tap may reach, it reaches.
            f"{plant_field}:7461", f"{controller_field}:7462",
        )
    )  # fmt: skip
    assert [target for target, connected in tried.items() if connected] == [
        f"{plant_field}:7461",
        f"{controller_field}:7462",
    ]
    assert len(tried) == 8
    # The addresses were right: the controller reaches the plant's management bus by the same one.
    assert outcomes(direct.python("controller", CONNECT, f"{plant}:7463")) == {
        f"{plant}:7463": True
    }


LISTEN = """
import json, time
from runtime.zenoh_bus import ZenohBus
heard, began = {}, time.monotonic()
with ZenohBus(connect=json.loads(%r)) as bus:
    bus.subscribe("**", lambda key, payload, t_ns: heard.update({key: heard.get(key, 0) + 1}))
    while not heard and time.monotonic() - began < 60:
        time.sleep(0.1)
    time.sleep(4)
print(json.dumps(heard))
"""


def test_a_listener_to_everything_hears_only_field_messages(direct: Composition) -> None:
    all_healthy(direct, SERVICES)
    field = json.dumps(["tcp/plant.field:7461", "tcp/controller.field:7462"])
    heard = json.loads(direct.python("tap", LISTEN % field).stdout)
    assert set(heard) == {"wyner/v2/loop/measurement", "wyner/v2/loop/offer"}
    assert min(heard.values()) > 10
    # The control: the same listener on the management bus does hear the statuses.
    management = json.dumps(["tcp/plant.management:7463", "tcp/controller.management:7464"])
    heard = json.loads(direct.python("controller", LISTEN % management).stdout)
    assert "wyner/v2/loop/management/plant/status" in heard
