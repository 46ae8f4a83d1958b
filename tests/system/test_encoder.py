"""A motor of which the encoder alone is read, live: both ends killed, and every check holds."""

import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.traces import events_of
from tests.system.test_integration import kill_and_see_it_back, status, wyner

pytestmark = [pytest.mark.slow, pytest.mark.integration]


@pytest.mark.long
def test_an_encoder_carries_keys_while_processes_are_killed(tmp_path: Path) -> None:
    """Of the tested steps more than 90 % agree, none wrongly, and the box holds the true state."""
    run_dir = tmp_path / "run"
    up = subprocess.Popen(
        [
            *(sys.executable, "-m", "wyner.cli.main", "up", "--scenario", "encoder"),
            *("--pace", "x2", "--run-dir", str(run_dir)),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        for victim in ("plant", "controller", "plant"):
            kill_and_see_it_back(up.pid, victim, run_dir)
        wait_for(lambda: status(run_dir, "plant").get("transitions", 0) > 450)
        up.send_signal(signal.SIGINT)
        assert up.wait(timeout=PATIENCE_S) == 130
    finally:
        up.kill()
        up.wait()
    found = wyner("check", str(run_dir))
    assert found.returncode == 0, found.stdout
    steps = list(events_of(run_dir / PLANT_TRACE, "transition"))
    assert len(steps) > 400
    inside = [
        all(a <= v <= b for a, v, b in zip(t["box"][0], x, t["box"][1], strict=True))
        for before, t in pairwise(steps)
        if before["k"] + 1 == t["k"] and (x := before.get("true_x_next"))
    ]
    assert len(inside) > 100  # fewer where a busy machine misses steps between
    assert all(inside)
    tested = [t for t in steps if t["role"] == "test"]
    agreed = [t for t in tested if t["symbol"] >= 0]
    assert len(agreed) > 0.9 * len(tested)
    assert all(t["symbol"] == t["coin"] for t in agreed)
    theirs = events_of(run_dir / CONTROLLER_TRACE, "transition")
    there = {(e["session"], e["j"]): e["box"] for e in theirs}
    both = [t for t in steps if (t["session"], t["j"]) in there]
    assert len(both) > 400
    assert all(there[t["session"], t["j"]] == t["box"] for t in both)
