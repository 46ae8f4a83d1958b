"""`wyner up --attack`: live runs in processes of their own."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S, wait_for
from tests.support.programs import started
from tests.system.test_integration import children_of, counted, status
from wyner.cli.main import main

pytestmark = [pytest.mark.slow, pytest.mark.integration]


@pytest.mark.long
def test_a_relay_that_is_killed_is_a_bus_that_is_down_for_a_while(tmp_path: Path) -> None:
    run = tmp_path / "run"
    command = ["-m", "wyner", "up", "--scenario", "packed", "--pace", "x10"]
    command += ["--attack", "covert@100000", "--message", "Hi", "--run-dir", str(run)]
    with started(*command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as up:
        wait_for(lambda: counted(run, "plant") > 20)
        missed = status(run, "plant")["step"]["missed"]
        os.kill(children_of(up.pid)["attacker"], signal.SIGKILL)
        wait_for(lambda: status(run, "plant")["step"]["missed"] > missed)
        wait_for(lambda: status(run, "plant")["frame"]["messages"] == 1)
        up.send_signal(signal.SIGINT)
        assert up.wait(PATIENCE_S) == 130
    summary = json.loads((run / "summary.json").read_text())
    assert summary["delivered"]
    assert summary["missed"] > 0
    assert main(["check", str(run)]) == 0
