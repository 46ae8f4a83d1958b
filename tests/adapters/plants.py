"""The double integrator as every kind of plant, and plants that fail in every way."""

import hashlib
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law, synthesise
from plant_service.adapters import Operated, OperatingPoint, PlantAdapter, Sample, SimulatedPlant
from plant_service.adapters.linear import Linear
from plant_service.adapters.ode import Ode
from protocol.agreement import NO_SYMBOL, Gauge
from protocol.scenario import Scenario
from protocol.vectors import Vector
from tests.simulate.beside import through_deaths_and_losses
from wyner.simulate.faults import Faults

A = ((1.0, 1.0), (0.0, 1.0))
B = ((0.5,), (1.0,))
START = (-5.0, -2.0)
PERIOD_S = 1.0
MODELS = Path(__file__).parent / "fmu_models"
KINDS = ("linear", "ode", "python", "fmi2", "fmi3", "gymnasium")


def operated(adapter: PlantAdapter, **more: Any) -> Operated:
    """The plant in deviations that are the physical values; U is [-1, 1]."""
    return Operated(adapter, OperatingPoint.origin(2, 1), Gauge(half_widths=(1.0,)), **more)


def dynamics(t: float, x: Any, u: Any) -> Vector:
    return (x[1], u[0])


class PythonLine:
    """An object as a user writes one: lists, and no more than two methods."""

    def reset(self, seed: int | None) -> list[float]:
        self.x = list(START)
        return self.x

    def step(self, u: Any, period_s: float) -> list[float]:
        place, speed = self.x
        self.x = [place + speed + 0.5 * u[0], speed + u[0]]
        return self.x


def build_fmu(model: str, folder: Path) -> tuple[Path, str]:
    """The FMU of a model file, and its SHA-256."""
    builder: Any
    if "fmi3" in model:
        builder = pytest.importorskip("pythonfmu3").FmuBuilder
    else:
        builder = pytest.importorskip("pythonfmu").FmuBuilder
    path = Path(builder.build_FMU(str(MODELS / f"{model}.py"), dest=str(folder)))
    return path, hashlib.sha256(path.read_bytes()).hexdigest()


def gymnasium_line() -> Any:
    gymnasium = pytest.importorskip("gymnasium")
    import numpy as np

    class Env(gymnasium.Env):  # type: ignore[misc,name-defined]
        observation_space = gymnasium.spaces.Box(-100, 100, (2,))
        action_space = gymnasium.spaces.Box(-2, 2, (1,))

        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            super().reset(seed=seed)
            self.state = np.array(START)
            return self.state, {}

        def step(self, action: Any) -> Any:
            place, speed = self.state
            u = action[0]
            self.state = np.array([place + speed + 0.5 * u, speed + u])
            return self.state, 0.0, False, False, {}

    return Env()


def line(kind: str, folder: Path) -> PlantAdapter:
    """The double integrator as a plant of this kind."""
    if kind == "linear":
        return SimulatedPlant(Linear(A, B, START), PERIOD_S)
    if kind == "ode":  # Runge-Kutta is exact where the solution is a polynomial
        return SimulatedPlant(Ode(dynamics, START, PERIOD_S, substeps=1), PERIOD_S)
    if kind == "python":
        return SimulatedPlant(PythonLine(), PERIOD_S)
    if kind == "gymnasium":
        from plant_service.adapters.gymnasium_env import StateEnvironment

        return SimulatedPlant(StateEnvironment(gymnasium_line(), "state"), PERIOD_S)
    from plant_service.adapters.fmu import Fmu

    pytest.importorskip("fmpy")
    path, sha256 = build_fmu(f"line_{kind}", folder)
    return SimulatedPlant(Fmu(path, sha256, ["u"], ["place", "speed"]), PERIOD_S)


class Device:
    """A device that is actuated and read, with a clock, and a switch for each way to fail."""

    def __init__(self, reading: Callable[[Vector], Vector] = lambda y: y) -> None:
        self.calls: list[str] = []
        self.y: Vector = START
        self.u = 0.0
        self.reading = reading
        self.frozen = False
        self.slow_s = 0.0
        self.raises: Exception | None = None
        self._t_ns = 1

    def start(self, seed: int | None) -> Sample:
        self.calls.append("start")
        self.y = START
        return Sample(self.reading(self.y), self._tick())

    def apply(self, u: Vector) -> None:
        self.calls.append("apply")
        if self.raises is not None:
            raise self.raises
        (self.u,) = u

    def sample(self) -> Sample:
        self.calls.append("sample")
        time.sleep(self.slow_s)
        place, speed = self.y
        self.y = (place + speed + 0.5 * self.u, speed + self.u)
        return Sample(self.reading(self.y), self._t_ns if self.frozen else self._tick())

    def safe(self) -> None:
        self.calls.append("safe")

    def close(self) -> None:
        self.calls.append("close")

    def _tick(self) -> int:
        self._t_ns += 1
        return self._t_ns


class Failing(PythonLine):
    """A simulation that fails with its first step."""

    def step(self, u: Any, period_s: float) -> list[float]:
        raise RuntimeError("the belt is torn")


@cache
def law_of(scenario: Scenario) -> CandidateLaw:
    """Its law, designed once."""
    return make_law(scenario, synthesise(scenario))


def lives_of(
    kind: str, folder: Path, sensor: Callable[[], Callable[[Vector], Vector]]
) -> Callable[[], PlantAdapter]:
    """What makes a plant of this kind for each life of its process; a device has this sensor."""
    if kind == "device":
        return lambda: Device(sensor())
    return lambda: line(kind, folder)


def through_deaths(scenario: Scenario, own: Callable[[], PlantAdapter]) -> None:
    """One message arrives exactly once and no key is wrong, over deaths and losses.

    A step counts only where its plant was put back where it started.
    """
    faults = Faults(loss=0.1, repeat=0.1, delay_s=0.2, crash=0.02, until_s=60.0)
    for history in through_deaths_and_losses(scenario, law_of(scenario), faults, 1.0, own=own):
        wrong = [t for t in history.plant.values() if t.symbol not in (NO_SYMBOL, t.coin)]
        assert not wrong
