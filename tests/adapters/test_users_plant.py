"""A user's plant runs in the plant's process: what it raises or answers ends it in one line."""

from pathlib import Path

import pytest

from plant_service.adapters import Operated, PlantError
from plant_service.adapters.registry import open_plant
from protocol.scenario import Scenario
from tests.adapters.test_device import line

PLANT = """
import sys
from tests.adapters.plants import PythonLine

class Line(PythonLine):
    steps = 0
    def step(self, u, period_s):
        self.steps += 1
        if self.steps == 3:
            {act}
        return super().step(u, period_s)
"""


def scenario_of(folder: Path, act: str) -> Scenario:
    (folder / "line.py").write_text(PLANT.format(act=act))
    return line("line.py:Line")


def opened(folder: Path, act: str) -> Operated:
    return open_plant(scenario_of(folder, act), folder)


def stepped(plant: Operated, steps: int) -> list[tuple[float, ...]]:
    xs = [plant.start(None)]
    for _ in range(steps):
        plant.apply((0.5,))
        xs.append(plant.sample())
    return xs


def test_it_steps_as_a_shipped_one(tmp_path: Path) -> None:
    own, shipped = opened(tmp_path, "pass"), open_plant(line())
    assert stepped(own, 20) == stepped(shipped, 20)
    own.close()
    shipped.close()


@pytest.mark.parametrize(
    ("act", "why"),
    [
        ("sys.exit(0)", "SystemExit: 0"),
        ("raise ValueError('no\\nidea')", "ValueError: no idea"),
        ("return ['?', 1]", "got the reading ['?', 1], expected a sequence of numbers"),
        ("return object()", "expected a sequence of numbers"),
    ],
)
def test_what_it_does_stops_the_plant_with_one_line(tmp_path: Path, act: str, why: str) -> None:
    plant = opened(tmp_path, act)
    with pytest.raises(PlantError, match=r"^plant: sample: ") as error:
        stepped(plant, 3)
    assert why in str(error.value)
    assert "\n" not in str(error.value)
    assert plant.fault
    with pytest.raises(PlantError, match="is in its safe state"):
        plant.sample()
    plant.close()
    fine = opened(tmp_path, "pass")  # the next one is a plant like any other
    assert len(stepped(fine, 4)) == 5
    fine.close()


def test_one_that_cannot_be_loaded_is_one_line(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, "pass")
    (tmp_path / "line.py").write_text("raise RuntimeError('no')")
    with pytest.raises(PlantError) as error:
        open_plant(scenario, tmp_path)
    assert str(error.value) == "plant: line.py: cannot be loaded: RuntimeError: no"
