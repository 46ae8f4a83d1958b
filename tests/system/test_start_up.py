"""What a service loads before its first word; how long that takes depends on the machine."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from controller_service.laws.registry import cached_design
from protocol.scenario import Scenario
from runtime.addresses import free_endpoints
from tests.support.patience import PATIENCE_S
from tests.support.programs import started

HEAVY = {"scipy", "osqp", "daqp", "rich", "matplotlib", "IPython", "asyncio"}


@pytest.mark.slow
@pytest.mark.parametrize("service", ["controller", "plant"])
def test_a_service_loads_little(service: str, sustained: Scenario, tmp_path: Path) -> None:
    """With the design in the cache; without it the controller computes it, with all that takes."""
    cached_design(sustained, cache_dir=tmp_path / "wyner" / "designs")
    field, management = free_endpoints(2)
    ends = (f"--listen=field={field}", f"--listen=management={management}")
    with started(
        *("-X", "importtime", "-m", "wyner", service, f"--run-dir={tmp_path}", *ends),
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)},
        stderr=subprocess.PIPE,
    ) as process:
        lines = []
        for line in process.stderr:
            lines.append(line)
            if f" {service} INFO session" in line:
                process.terminate()
        assert process.wait(PATIENCE_S) == 0, lines[-3:]
    found = {re.split(r"[.\s]", line.rpartition("|")[2].strip())[0] for line in lines}
    assert f"{service}_service" in found
    assert not found & HEAVY
