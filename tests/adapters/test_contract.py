"""What every adapter holds to, whatever is behind it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from plant_service.adapters import Operated, OperatingPoint, PlantError, SimulatedPlant
from protocol.agreement import Gauge
from tests.adapters.plants import KINDS, START, Device, PythonLine, line, operated

INPUTS = [(0.25,), (-1.0,), (0.7,), (1.0,), (-0.3,)]


@pytest.fixture(params=(*KINDS, "device"))
def plant(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Operated]:
    kind = request.param
    made = operated(Device() if kind == "device" else line(kind, tmp_path))
    yield made
    made.safe()
    made.close()


def trajectory(plant: Operated) -> list[tuple[float, ...]]:
    states = [plant.start(1)]
    for u in INPUTS:
        plant.apply(u)
        states.append(plant.sample())
    return states


def test_started_twice_it_does_the_same(plant: Operated) -> None:
    first = trajectory(plant)
    assert first[0] == START
    assert trajectory(plant) == first


def test_it_is_the_double_integrator_to_rounding(plant: Operated) -> None:
    x = START
    for u, got in zip(INPUTS, trajectory(plant)[1:], strict=True):
        x = (x[0] + x[1] + 0.5 * u[0], x[1] + u[0])
        assert got == pytest.approx(x, abs=1e-12)


def test_what_is_beyond_u_is_clipped_and_said(plant: Operated) -> None:
    plant.start(1)
    assert plant.apply((3.0,)) == (1.0,)
    clipped = plant.sample()
    plant.start(1)
    assert plant.apply((1.0,)) == (1.0,)
    assert plant.sample() == clipped


def test_safe_is_for_good_and_does_no_harm_twice(plant: Operated) -> None:
    plant.start(1)
    plant.safe("the button was pressed")
    plant.safe("again")
    with pytest.raises(PlantError, match="safe state: the button was pressed"):
        plant.apply((0.0,))
    with pytest.raises(PlantError, match="safe state"):
        plant.start(1)


@pytest.mark.parametrize("kind", ["linear", "ode", "gymnasium"])
def test_a_plant_whose_reading_is_its_state_goes_on_from_one(kind: str, tmp_path: Path) -> None:
    plant = operated(line(kind, tmp_path))
    assert plant.resumable
    whole = trajectory(plant)
    other = operated(line(kind, tmp_path))
    other.start(1)
    other.resume(whole[3], 3)
    other.apply(INPUTS[3])
    assert other.sample() == whole[4]


@pytest.mark.parametrize("kind", ["linear", "ode", "gymnasium"])
def test_a_disturbance_is_added_to_the_state_and_stays_there(kind: str, tmp_path: Path) -> None:
    plant = operated(line(kind, tmp_path))
    assert plant.displaceable
    plant.start(1)
    plant.apply((0.0,))
    assert plant.sample((0.5, 0.25)) == (-6.5, -1.75)
    plant.apply((0.0,))
    assert plant.sample() == (-8.25, -1.75)


# --- a device that fails --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reading", "says"),
    [
        ((float("nan"), 0.0), r"got the reading \[nan, 0.0\], expected finite numbers"),
        ((float("inf"), 0.0), "expected finite numbers"),
        ((0.0,), "got 1 readings, expected 2"),
        ((0.0, 0.0, 0.0), "got 3 readings, expected 2"),
        ((60.0, 0.0), "got 60.0 as reading 1, expected -50.0 to 50.0"),
    ],
)
def test_a_bad_reading_makes_it_safe(reading: tuple[float, ...], says: str) -> None:
    device = Device()
    plant = operated(device, limits=((-50.0, 50.0), (-50.0, 50.0)), name="tank")
    plant.start(None)
    device.reading = lambda _: reading
    plant.apply((0.0,))
    with pytest.raises(PlantError, match=f"^tank: .*{says}"):
        plant.sample()
    assert device.calls[-1] == "safe"
    with pytest.raises(PlantError, match="is in its safe state"):
        plant.apply((0.0,))


def test_a_reading_of_the_same_time_is_stale() -> None:
    device = Device()
    plant = operated(device)
    plant.start(None)
    plant.apply((0.0,))
    device.frozen = True
    with pytest.raises(PlantError, match=r"of time 2 ns again, expected a newer one"):
        plant.sample()
    assert device.calls[-1] == "safe"


def test_an_exception_is_one_line_and_makes_it_safe() -> None:
    device = Device()
    plant = operated(device)
    plant.start(None)
    device.raises = OSError("bus\nerror")
    with pytest.raises(PlantError, match="plant: apply: OSError: bus error"):
        plant.apply((0.0,))
    assert device.calls[-1] == "safe"


def test_a_safe_that_raises_is_told_and_not_raised() -> None:
    class Broken(Device):
        def safe(self) -> None:
            raise RuntimeError("no answer")

    plant = operated(Broken())
    plant.start(None)
    plant.safe("test")
    assert plant.fault == "test; and its safe() failed: no answer"


def test_reading_before_the_first_input_is_refused() -> None:
    plant = operated(SimulatedPlant(PythonLine(), 1.0))
    plant.start(None)
    with pytest.raises(PlantError, match="read before an input was applied"):
        plant.sample()


# --- units ----------------------------------------------------------------------------------------


def test_deviations_are_counted_from_the_operating_point_in_units_of_the_scale() -> None:
    point = OperatingPoint((-6.0, -2.0), (0.5,), (2.0, 4.0), (0.1,))
    plant = Operated(SimulatedPlant(PythonLine(), 1.0), point, Gauge(half_widths=(10.0,)))
    assert plant.start(None) == (0.5, 0.0)
    plant.apply((5.0,))  # 0.5 + 0.1 * 5 = 1 in physical units
    assert plant.sample() == ((-6.5 + 6.0) / 2.0, (-1.0 + 2.0) / 4.0)
