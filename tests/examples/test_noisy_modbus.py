"""The device behind Modbus TCP with a sensor of some thousandths' noise."""

import random
import runpy
import threading
from typing import Any

import pytest

from tests.examples.test_examples import PROGRAMS
from wyner import build, run

NOISE = 0.003
"""Half-width that both ends assume, rounding included; the sensor adds two thousandths."""


@pytest.mark.slow
def test_a_noisy_register_carries_keys_and_none_is_wrong() -> None:
    """200 steps, seed 1."""
    pytest.importorskip("pymodbus")
    (path,) = (program for program in PROGRAMS if program.stem == "modbus_plant")
    names = runpy.run_path(str(path))
    draw = random.Random(4)
    base: Any = names["SimulatedDevice"]

    class Noisy(base):  # type: ignore[misc]
        """Its level is read with noise."""

        def write(self, address: int, value: int) -> None:
            super().write(address, value)
            read = round(self.level * 1000) + draw.choice((-2, 2))
            self.registers[names["LEVEL"]] = read & 0xFFFF

    tables = {
        **names["SCENARIO"],
        "defender": {**names["SCENARIO"]["defender"], "noise": {"half_widths": [NOISE]}},
        "secrecy": {"alpha": 12.0, "candidates": 2},
    }
    with Noisy(("127.0.0.1", 0), names["Handler"]) as device:
        threading.Thread(target=device.serve_forever, daemon=True).start()
        plant = names["ModbusTank"](port=device.server_address[1])
        runs = run(build(tables), steps=200, seed=1, plant=plant)
        device.shutdown()
    tested = int((runs.message_symbol < 0).sum())
    assert runs.agreements[0] == tested > 90
    agreed = runs.key >= 0
    assert (runs.key == runs.coin)[agreed].all()
