"""What goes wrong with containers, and the message that arrives all the same."""

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.compose.composition import (
    PATIENCE_S,
    ROOT,
    Composition,
    advancing,
    arrives,
    docker,
    under_way,
)

SERVICES = ("controller", "plant", "tap")


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_killed_in_the_middle_comes_back(direct: Composition, service: str) -> None:
    advancing(direct)
    text = f"{service} killed"
    under_way(direct, text)
    before = direct.inspect(service)
    direct.kill(service)
    arrives(direct, "plant", text)
    after = direct.inspect(service)
    assert after["RestartCount"] == before["RestartCount"] + 1
    assert direct.recovered("plant").count(text) == 1


@pytest.mark.parametrize("service", ["controller", "plant"])
def test_a_paused_service_is_waited_for(direct: Composition, service: str) -> None:
    advancing(direct)
    partner = "plant" if service == "controller" else "controller"
    text = f"{service} paused"
    under_way(direct, text)
    docker("pause", direct.container(service))
    try:
        until = time.monotonic() + 60
        check = direct.execute(partner, "healthy", partner, check=False)
        while check.returncode == 0 and time.monotonic() < until:
            time.sleep(1)
            check = direct.execute(partner, "healthy", partner, check=False)
    finally:
        docker("unpause", direct.container(service))
    # The partner runs, but the loop does not advance, and its health check says so.
    assert check.returncode == 1
    assert check.stdout.startswith("bad: ")
    arrives(direct, "plant", text)


def test_after_all_that_the_traces_obey_the_paper(direct: Composition, tmp_path: Path) -> None:
    """The run's files, collected from the three volumes, pass the replay of `wyner check`."""
    direct.compose("stop")
    for service in SERVICES:
        assert direct.inspect(service)["State"]["ExitCode"] == 0, "it needed more than its grace"
        source = f"{direct.container(service)}:/var/lib/wyner/run/{service}"
        docker("cp", source, str(tmp_path / service))
    shutil.copyfile(ROOT / "runtime/scenarios/sustained.toml", tmp_path / "scenario.toml")
    checked = subprocess.run(
        [sys.executable, "-m", "wyner.cli.main", "check", str(tmp_path), "--json"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
    rules = json.loads(checked.stdout)["rules"]
    skipped = [rule["name"] for rule in rules if rule["result"] == "SKIP"]
    assert skipped == ["same-keys"], checked.stdout  # this scenario makes none
