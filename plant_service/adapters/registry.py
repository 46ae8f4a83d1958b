"""The kinds of plants by name: the table ``[plant]`` that a kind reads, and what opens it.

A kind is a table with a method ``adapter``; :func:`open_plant` adds the wrapper. Nothing of a
user's is loaded before that.
"""

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, field_validator

from plant_service.adapters.base import PlantAdapter, PlantError, SimulatedPlant, Stepped, stepped
from plant_service.adapters.linear import Linear
from plant_service.adapters.operated import Operated, OperatingPoint
from protocol.agreement import Gauge
from protocol.scenario import PLANTS, PlantTable, Scenario
from protocol.scenario.parts import Positive
from protocol.vectors import FiniteMatrix, FiniteVector
from runtime.user_code import UserCodeError


class LinearPlant(PlantTable):
    """x+ = A x + B u + d."""

    kind: Literal["linear"] = "linear"
    """A linear plant, simulated exactly."""
    A: FiniteMatrix
    """State matrix, n rows of n numbers."""
    B: FiniteMatrix
    """Input matrix, n rows of m numbers."""
    initial_state: FiniteVector
    """x(0), n numbers."""

    def adapter(self, start: FiniteVector, folder: Path) -> PlantAdapter:  # noqa: ARG002
        """The plant at the reading ``start``."""
        return SimulatedPlant(Linear(self.A, self.B, start), self.period_s)


class ModelledElsewhere(PlantTable):
    """A plant that is no matrices: those of its model stand under ``[defender]``.

    Its code runs in the plant's process, with that process's rights: it is trusted.
    """

    @field_validator("A", "B")
    @classmethod
    def _no_matrices(cls, matrix: FiniteMatrix | None) -> FiniteMatrix | None:
        if matrix is not None:
            raise ValueError("expected it under [defender]: a plant of this kind has none")
        return matrix


def _as_it_stands(start: object) -> object:
    """Refuse a start where the plant brings its own."""
    if start not in ((), []):
        raise ValueError("expected none: a plant of this kind begins where its own code says")
    return start


AsItStands = Annotated[tuple[()], BeforeValidator(_as_it_stands)]


class OdePlant(ModelledElsewhere):
    """dx/dt = f(t, x, u), the function ``object``, in physical units."""

    kind: Literal["ode"]
    """An ordinary differential equation."""
    object: str
    """The function f(t, x, u), as FILE.py:NAME or module:NAME."""
    substeps: Annotated[int, Field(ge=1, le=10000)] = 10
    """Runge-Kutta steps to a period."""
    initial_state: FiniteVector
    """x(0) as a deviation from the operating point."""

    def adapter(self, start: FiniteVector, folder: Path) -> PlantAdapter:
        """The plant at the reading ``start``."""
        from plant_service.adapters.ode import Ode
        from runtime.user_code import load_attribute

        function = load_attribute(self.object, folder)
        if not callable(function):
            raise PlantError(f"{self.object}: expected a function of t, x and u")
        return SimulatedPlant(Ode(function, start, self.period_s, self.substeps), self.period_s)


class PythonPlant(ModelledElsewhere):
    """The object or class ``object``, a :class:`Stepped` plant or a :class:`PlantAdapter`."""

    kind: Literal["python"]
    """A Python object."""
    object: str
    """The object or class, as FILE.py:NAME or module:NAME."""
    settle_s: Positive | None = None
    """Seconds to run at the operating input before step 0."""
    initial_state: AsItStands = ()
    """None: it starts as it stands."""

    def adapter(self, start: FiniteVector, folder: Path) -> PlantAdapter:  # noqa: ARG002
        """The plant as it stands."""
        from runtime.user_code import load_attribute, made

        plant = made(load_attribute(self.object, folder), self.object)
        return _adapted(plant, self.object, self.period_s)


class FmuPlant(ModelledElsewhere):
    """A co-simulation FMU, pinned by its hash; its outputs are the state."""

    kind: Literal["fmu"]
    """A co-simulation FMU."""
    file: str
    """The .fmu file, beside the scenario."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-fA-F]{64}$")]
    """Its SHA-256; another file is refused."""
    inputs: tuple[str, ...]
    """Names of its inputs, in the order of u."""
    outputs: tuple[str, ...]
    """Names of its outputs, in the order of x."""
    start: dict[str, float] | None = None
    """Start values by name."""
    seed: str | None = None
    """The parameter that takes a session's seed, for a model with chance of its own."""
    settle_s: Positive | None = None
    """Seconds to run at the operating input before step 0."""
    initial_state: AsItStands = ()
    """None: it starts as it stands."""

    def adapter(self, start: FiniteVector, folder: Path) -> PlantAdapter:  # noqa: ARG002
        """The plant as the file has it."""
        from plant_service.adapters.fmu import Fmu

        path = folder / self.file
        fmu = Fmu(path, self.sha256, self.inputs, self.outputs, self.start, self.seed)
        return SimulatedPlant(fmu, self.period_s)


class GymnasiumPlant(ModelledElsewhere):
    """The environment ``id``; ``state`` names the attribute that is read in full precision."""

    kind: Literal["gymnasium"]
    """A Gymnasium environment."""
    id: str
    """Its id."""
    state: str | None = None
    """Attribute that holds the state in full precision; the observation where not given."""
    arguments: dict[str, Any] | None = None
    """Arguments of gymnasium.make."""

    def adapter(self, start: FiniteVector, folder: Path) -> PlantAdapter:  # noqa: ARG002
        """The environment, at ``start`` where the file has an initial state."""
        from plant_service.adapters.gymnasium_env import make

        if self.initial_state and self.state is None:
            raise PlantError(
                "initial_state: an environment starts where it wants, expected none, or state = "
                "the attribute that can be set"
            )
        at = start if self.initial_state else None
        env = make(self.id, self.state, at, self.period_s, self.arguments)
        return SimulatedPlant(env, self.period_s)


KINDS: tuple[type[PlantTable], ...] = (LinearPlant, OdePlant, PythonPlant, FmuPlant, GymnasiumPlant)
for kind in KINDS:
    (name,) = kind.model_fields["kind"].annotation.__args__  # type: ignore[union-attr]
    PLANTS.register(name, kind)


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
        adapter: PlantAdapter
        start = _start(scenario)
        if own is None:
            adapter = plant.adapter(start, folder)  # type: ignore[attr-defined]
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
    settle_s = getattr(plant, "settle_s", None)
    operated = Operated(
        adapter,
        point,
        Gauge.from_rows(*scenario.control.inputs.rows()),
        settle_steps=0 if settle_s is None else round(settle_s / plant.period_s),
        limits=plant.limits,
    )
    if plant.disturbance.enters in (None, "state") and not operated.displaceable:
        operated.close()
        raise PlantError(
            "plant.disturbance.enters: got 'state', expected 'input' or 'none': the state of a "
            f"plant of kind {plant.kind!r} cannot be written to"
        )
    return operated


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
