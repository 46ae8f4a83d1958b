"""One linear plant as every kind gives the same run, step by step, as the engine does."""

from pathlib import Path

import numpy as np
import pytest

from plant_service.adapters import PlantError
from plant_service.adapters.registry import open_plant
from protocol.scenario import Scenario
from tests.adapters.plants import PythonLine, build_fmu
from wyner.api import System, build, design, load, run, vary
from wyner.simulate.engine import Runs, SimulationError, simulate_runs

STEPS = 150


@pytest.fixture(scope="module")
def system() -> System:
    return design("double-integrator")


@pytest.fixture(scope="module")
def undisturbed() -> System:
    """For plants whose state cannot be written to."""
    return design(vary(load("double-integrator"), {"plant.disturbance.half_widths": [0.0, 0.0]}))


def quiet(scenario: Scenario) -> Scenario:
    return vary(scenario, {"plant.disturbance": {"enters": "none"}})


def same(one: Runs, two: Runs) -> None:
    """States to rounding; coins, verdicts and agreements exactly."""
    assert one.x is not None and two.x is not None
    assert one.gauges is not None and two.gauges is not None
    assert (one.coin == two.coin).all()
    assert (one.symbol == two.symbol).all()
    assert np.abs(one.x - two.x).max() < 1e-12
    assert np.abs(one.gauges - two.gauges).max() < 1e-9


def tables(undisturbed: System) -> dict[str, object]:
    data = undisturbed.scenario.model_dump(exclude_none=True)
    plant = data["plant"]
    data["defender"] |= {"A": plant["A"], "B": plant["B"]}
    data["plant"] = {"period_s": 1.0, "disturbance": {"enters": "none"}}
    return data


def test_the_kinds_of_a_file_open_and_run(undisturbed: System, tmp_path: Path) -> None:
    """The same plant named in a scenario as a function, an object and an FMU."""
    path, sha256 = build_fmu("line_fmi2", tmp_path)
    (tmp_path / "mine.py").write_text(
        "def dynamics(t, x, u): return x[1], u[0]\n"
        "from tests.adapters.plants import PythonLine, Device\n"
    )
    kinds: list[dict[str, object]] = [
        {"kind": "ode", "object": "mine.py:dynamics", "substeps": 1, "initial_state": [-5.0, -2.0]},
        {"kind": "python", "object": "mine.py:PythonLine"},
        {"kind": "python", "object": "mine.py:Device"},
        {
            "kind": "fmu",
            "file": path.name,
            "sha256": sha256,
            "inputs": ["u"],
            "outputs": ["place", "speed"],
        },
    ]
    expected = simulate_runs(
        undisturbed.scenario, undisturbed.law, seed=1, runs=range(1), steps=40, record=True
    )
    for fields in kinds:
        data = tables(undisturbed)
        data["plant"] = {**data["plant"], **fields}  # type: ignore[dict-item]
        system = System(build(data), undisturbed.design, undisturbed.law)
        same(expected, run(system, steps=40, seed=1, folder=tmp_path).record)


def test_what_cannot_be_written_to_cannot_be_disturbed(
    system: System, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(PlantError, match=r"^plant.disturbance.enters: got 'state', expected 'inp"):
        run(system, plant=PythonLine())


def test_a_plant_that_fails_stops_the_run_and_says_where(system: System) -> None:
    class Broken(PythonLine):
        def step(self, u: object, period_s: float) -> list[float]:
            if self.x[0] > -3:
                raise RuntimeError("belt torn")
            return super().step(u, period_s)

    scenario = quiet(system.scenario)
    with pytest.raises(SimulationError, match=r"^run 0, step \d+: plant: .*belt torn"):
        run(System(scenario, system.design, system.law), plant=Broken())


def test_a_plant_named_but_not_there_is_one_line(undisturbed: System, tmp_path: Path) -> None:
    data = tables(undisturbed)
    data["plant"] = {**data["plant"], "kind": "python", "object": "gone.py:x"}  # type: ignore[dict-item]
    with pytest.raises(PlantError, match=r"^plant: .*gone.py: no such file$"):
        open_plant(build(data), tmp_path)
