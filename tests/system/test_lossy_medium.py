"""A medium that really loses: the tap's datagrams are dropped by the kernel, not by a knob.

The tap listens in a network namespace of its own, where a packet filter drops a share of what
comes. Over UDP a lost datagram stays lost, and the keys hold. Over TCP it is sent again: she hears
all, and the audit refutes the claim.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from protocol.runtime.endpoints import free_endpoints
from protocol.shipped import SCENARIOS
from wyner.cli.main import main
from wyner.scoring.summary import summarise

pytestmark = [pytest.mark.slow, pytest.mark.integration]

STEPS = {"udp": 900, "tcp": 340}
"""Five key blocks, and three; a link over UDP may take seconds to come up."""

PORT = 17471
HERE, THERE = "10.231.7.1", "10.231.7.2"


def sh(*command: str) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


class Namespace:
    """The tap's machine: one link to ours, and a filter on it."""

    def __init__(self) -> None:
        self.name = f"wyner{os.getpid()}"
        self.link = f"wy{os.getpid() % 10**8}"
        self.prefix = ["ip", "netns", "exec", self.name]
        other = f"{self.link}p"
        self.works = all(
            sh(*command)
            for command in (
                ("ip", "netns", "add", self.name),
                ("ip", "link", "add", self.link, "type", "veth", "peer", "name", other),
                ("ip", "link", "set", other, "netns", self.name),
                ("ip", "addr", "add", f"{HERE}/30", "dev", self.link),
                ("ip", "link", "set", self.link, "up"),
                (*self.prefix, "ip", "addr", "add", f"{THERE}/30", "dev", other),
                (*self.prefix, "ip", "link", "set", other, "up"),
                (*self.prefix, "ip", "link", "set", "lo", "up"),
            )
        )

    def drop(self, protocol: str, share: float) -> bool:
        chance = ("-m", "statistic", "--mode", "random", "--probability", str(share))
        # Measurements and offers; a lost greeting of the transport's would only cost ten seconds.
        large = ("-m", "length", "--length", "220:65535")
        rule = ("-A", "INPUT", "-p", protocol, "--dport", str(PORT), *large, *chance, "-j", "DROP")
        return sh(*self.prefix, "iptables", *rule)

    def remove(self) -> None:
        sh("ip", "link", "del", self.link)
        sh("ip", "netns", "del", self.name)


@pytest.fixture
def namespace() -> Iterator[Namespace]:
    if os.geteuid() != 0 or shutil.which("ip") is None or shutil.which("iptables") is None:
        pytest.skip("network namespaces need root, ip and iptables")
    place = Namespace()
    try:
        if not place.works:
            pytest.skip("network namespaces are not allowed here")
        yield place
    finally:
        place.remove()


def keys_of_a_run(namespace: Namespace, protocol: str, folder: Path) -> dict[str, Any]:
    """Run controller, plant and tap, the field bus over ``protocol``; what the summary says."""
    run = folder / "run"
    assert main(["knowledge", "keys", "--output", str(folder / "knowledge.json")]) == 0
    tap = f"{protocol}/{THERE}:{PORT}"
    ends = (end.removeprefix("tcp/") for end in free_endpoints(4))
    plant_field, controller_field, plant_ops, controller_ops = ends
    common = ["--scenario", str(SCENARIOS / "keys.toml"), "--run-dir", str(run)]
    wyner = [sys.executable, "-m", "wyner"]
    commands = {
        "tap": [
            *(*namespace.prefix, *wyner, "tap", "--knowledge", str(folder / "knowledge.json")),
            *("--run-dir", str(run), "--eavesdropper", "nearest-centre", "--loss", "0"),
            *("--finish", "1", "--listen", f"field={tap}", "--listen", "intel=tcp/127.0.0.1:17475"),
        ],
        "plant": [
            *(*wyner, "plant", *common, "--pace", "x10", "--steps", str(STEPS[protocol])),
            *("--listen", f"field={protocol}/{plant_field}", "--connect", f"field={tap}"),
            *("--listen", f"ops=tcp/{plant_ops}"),
        ],
        "controller": [
            *(*wyner, "controller", *common, "--message", "hello"),
            *("--listen", f"field={protocol}/{controller_field}", "--connect", f"field={tap}"),
            *("--connect", f"field={protocol}/{plant_field}"),
            *("--listen", f"ops=tcp/{controller_ops}", "--connect", f"ops=tcp/{plant_ops}"),
        ],
    }
    processes: dict[str, subprocess.Popen[bytes]] = {}
    log = folder / "log"
    try:
        for name, command in commands.items():
            with log.open("ab") as file:
                processes[name] = subprocess.Popen(command, stdout=file, stderr=file)
            if name == "tap":  # it is to hear the first message
                _until_it_listens(log)
        assert processes["plant"].wait(120) == 0, log.read_text()
        for name in ("controller", "tap"):
            processes[name].terminate()
            processes[name].wait(30)
    finally:
        for process in processes.values():
            process.kill()
            process.wait()
    keys: dict[str, Any] = summarise(run, b"hello")["keys"]
    return keys


def _until_it_listens(log: Path) -> None:
    until = time.monotonic() + 30
    while "listening" not in log.read_text():
        assert time.monotonic() < until, log.read_text()
        time.sleep(0.05)
    time.sleep(1.0)  # it says so before its socket is open


def test_over_udp_she_misses_what_the_kernel_drops_and_the_keys_hold(
    namespace: Namespace, tmp_path: Path
) -> None:
    if not namespace.drop("udp", 0.35):
        pytest.skip("this kernel's packet filter drops nothing at random")
    keys = keys_of_a_run(namespace, "udp", tmp_path)
    if keys["missed_by_tap"] == 1:
        pytest.skip("the tap's link came up too late")
    assert keys["missed_by_tap"] > 0.28
    assert keys["made"] > 20
    assert keys["same_at_both_ends"]
    assert (keys["held_by_tap_bits"], keys["warnings"]) == (0, [])


def test_over_tcp_she_hears_all_and_the_audit_refutes_the_claim(
    namespace: Namespace, tmp_path: Path
) -> None:
    if not namespace.drop("tcp", 0.05):
        pytest.skip("this kernel's packet filter drops nothing at random")
    keys = keys_of_a_run(namespace, "tcp", tmp_path)
    assert keys["missed_by_tap"] < 0.1
    assert keys["held_by_tap_bits"] > 0
    assert any("refuted" in warning for warning in keys["warnings"])
