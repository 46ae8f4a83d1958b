"""What a service loads before its first word; how long that takes depends on the machine."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from controller_service.laws.registry import cached_design
from protocol.scenario import Scenario
from runtime.addresses import free_endpoints

HEAVY = {"scipy", "osqp", "daqp", "rich", "matplotlib", "IPython", "asyncio"}


@pytest.mark.slow
@pytest.mark.parametrize("service", ["controller", "plant"])
def test_a_service_loads_little(service: str, sustained: Scenario, tmp_path: Path) -> None:
    """With the design in the cache; without it the controller computes it, with all that takes."""
    cached_design(sustained, cache_dir=tmp_path / "wyner" / "designs")
    field, management = free_endpoints(2)
    command = [sys.executable, "-X", "importtime", "-m", "wyner", service]
    with subprocess.Popen(
        [
            *command,
            f"--run-dir={tmp_path}",
            f"--listen=field={field}",
            f"--listen=management={management}",
        ],
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            lines.append(line)
            if f" {service} INFO session" in line:
                process.terminate()
    assert process.returncode == 0, lines[-3:]
    found = {re.split(r"[.\s]", line.rpartition("|")[2].strip())[0] for line in lines}
    assert f"{service}_service" in found
    assert not found & HEAVY
