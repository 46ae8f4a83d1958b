"""Opening the scenario's plant, of whatever kind; nothing of a user's is loaded before that."""

from pathlib import Path
from typing import Any, Final

from plant_service.adapters.base import PlantAdapter, PlantError, SimulatedPlant, Stepped, stepped
from plant_service.adapters.linear import Linear
from plant_service.adapters.operated import Operated, OperatingPoint
from protocol.agreement import Gauge
from protocol.scenario import PlantTable, Scenario
from protocol.scenario.plants import (
    FmuPlant,
    GymnasiumPlant,
    LinearPlant,
    OdePlant,
    PythonPlant,
)
from protocol.vectors import FiniteVector
from runtime.user_code import UserCodeError, load_attribute, made

SINGLE: Final = 1e-6
"""Relative rounding of the single precision in which environments state their bounds."""

NOISE_OF_ITS_OWN = "plant.noise: expected none of a device, whose sensors have their own"
"""Why a device's scenario is refused that would have noise simulated."""


def is_model(scenario: Scenario) -> bool:
    """Whether the plant is two matrices and nothing else, which nobody has to open."""
    plant = scenario.plant
    return (
        plant.kind == "linear"
        and plant.operating_point is None
        and plant.limits is None
        and plant.disturbance.enters in (None, "state")
    )


def open_plant(
    scenario: Scenario, folder: Path = Path(), own: Stepped | PlantAdapter | None = None
) -> Operated:
    """The scenario's plant in deviations; it is not started yet.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Where the files that the scenario names are looked for.
    own : Stepped or PlantAdapter, optional
        In place of what the scenario names.

    Raises
    ------
    PlantError
        With one line that begins with ``plant``: something that it names is missing or unfit.
    """
    plant, m = scenario.plant, scenario.m
    try:
        if own is None:
            adapter = _adapter(plant, _start(scenario), folder)
        else:
            adapter = _adapted(own, type(own).__name__, plant.period_s)
    except (PlantError, UserCodeError) as error:
        raise PlantError(f"plant: {error}") from error.__cause__
    if problem := _beyond_actions(scenario, adapter):
        adapter.close()
        raise PlantError(problem)
    n = scenario.n if isinstance(adapter, SimulatedPlant) else scenario.readings
    said = plant.operating_point.given if plant.operating_point is not None else 0
    if said not in (0, n) or len(plant.limits or ()) not in (0, n):
        adapter.close()
        raise PlantError(
            f"plant.operating_point, plant.limits: expected {n} numbers, as many as the plant gives"
        )
    point = _point(scenario, n, m)
    operated = Operated(
        adapter,
        point,
        Gauge.from_rows(*scenario.control.inputs.rows()),
        limits=plant.limits,
    )
    if plant.disturbance.enters in (None, "state") and not operated.displaceable:
        operated.close()
        raise PlantError(
            "plant.disturbance.enters: got 'state', expected 'input' or 'none': the state of a "
            f"plant of kind {plant.kind!r} cannot be written to"
        )
    return operated


def _adapter(plant: PlantTable, start: FiniteVector, folder: Path) -> PlantAdapter:
    """What a table names, at the reading ``start`` where it can be put there."""
    match plant:
        case LinearPlant(A=A, B=B):
            return SimulatedPlant(Linear(A, B, start), plant.period_s)
        case OdePlant():
            from plant_service.adapters.ode import Ode

            function = load_attribute(plant.object, folder)
            if not callable(function):
                raise PlantError(f"{plant.object}: expected a function of t, x and u")
            ode = Ode(function, start, plant.period_s, plant.substeps)
            return SimulatedPlant(ode, plant.period_s)
        case PythonPlant():
            own = made(load_attribute(plant.object, folder), plant.object)
            return _adapted(own, plant.object, plant.period_s)
        case FmuPlant():
            from plant_service.adapters.fmu import Fmu

            path = folder / plant.file
            fmu = Fmu(path, plant.sha256, plant.inputs, plant.outputs, plant.start, plant.seed)
            return SimulatedPlant(fmu, plant.period_s)
        case GymnasiumPlant():
            from plant_service.adapters.gymnasium_env import make

            if plant.initial_state and plant.state is None:
                raise PlantError(
                    "initial_state: an environment starts where it wants, expected none, or state "
                    "= the attribute that can be set"
                )
            at = start if plant.initial_state else None
            env = make(plant.id, plant.state, at, plant.period_s, plant.arguments)
            return SimulatedPlant(env, plant.period_s)
    raise PlantError(f"kind: got {plant.kind!r}, expected one that can be opened")


def _beyond_actions(scenario: Scenario, adapter: PlantAdapter) -> str:
    """Why U does not fit into the inputs that an environment takes; empty where it does."""
    core = adapter.plant if isinstance(adapter, SimulatedPlant) else adapter
    actions = getattr(core, "actions", None)
    if actions is None:
        return ""
    m = scenario.m
    if len(actions) != m:
        return f"control.inputs: got {m} inputs, expected {len(actions)}, as the environment takes"
    point, U = _point(scenario, scenario.n, m), scenario.control.inputs
    for i, (low, high) in enumerate(actions):
        up = [float(j == i) for j in range(m)]
        most = point.input[i] + point.input_scale[i] * U.reach(up)
        least = point.input[i] - point.input_scale[i] * U.reach([-v for v in up])
        rounding = SINGLE * max(abs(most), abs(least))
        if least < low - rounding or most > high + rounding:
            return (
                f"control.inputs: got input {i + 1} from {least:g} to {most:g}, expected it within "
                f"{low:g} to {high:g}, the environment's action space"
            )
    return ""


def _start(scenario: Scenario) -> FiniteVector:
    """Where a simulation starts, in its own units; empty where it starts as it stands."""
    table = scenario.plant.operating_point
    if table is not None and table.given not in (0, scenario.n):  # of a device
        return ()
    return _point(scenario, scenario.n, scenario.m).reading(scenario.initial_state)


def _adapted(plant: Any, name: str, period_s: float) -> PlantAdapter:
    """A device as it is, a simulation within its wrapper."""
    if all(callable(getattr(plant, method, None)) for method in ("start", "apply", "sample")):
        found: PlantAdapter = plant
        return found
    return SimulatedPlant(stepped(plant, name), period_s)


def _point(scenario: Scenario, n: int, m: int) -> OperatingPoint:
    table = scenario.plant.operating_point
    origin = OperatingPoint.origin(n, m)
    if table is None:
        return origin
    return OperatingPoint(
        table.state or origin.state,
        table.input,
        table.state_scale or origin.state_scale,
        table.input_scale or origin.input_scale,
    )
