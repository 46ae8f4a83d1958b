"""The kinds of plants: what each reads of ``[plant]`` beside the common fields."""

from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, field_validator

from protocol.scenario.plant import PlantTable
from protocol.vectors import FiniteMatrix, FiniteVector


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


class PythonPlant(ModelledElsewhere):
    """The object or class ``object``, a :class:`Stepped` plant or a :class:`PlantAdapter`."""

    kind: Literal["python"]
    """A Python object."""
    object: str
    """The object or class, as FILE.py:NAME or module:NAME."""
    initial_state: AsItStands = ()
    """None: it starts as it stands."""


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
    initial_state: AsItStands = ()
    """None: it starts as it stands."""


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


PLANTS: Final[dict[str, type[PlantTable]]] = {
    "linear": LinearPlant,
    "ode": OdePlant,
    "python": PythonPlant,
    "fmu": FmuPlant,
    "gymnasium": GymnasiumPlant,
}
"""For each kind of plant the table ``[plant]`` that it reads."""
