"""What a plant is, seen from the plant service, in physical units.

Two calls and not one, because a device is actuated when the offer comes and read when the step
ends. What most people write is one call, ``step``; :class:`SimulatedPlant` makes the two of it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

from protocol.vectors import Vector
from runtime.errors import Failure


class PlantError(Failure):
    """A plant that failed or spoke nonsense; one line that names the plant and what it did."""


class Sample(NamedTuple):
    """A reading.

    Parameters
    ----------
    y : tuple of float, shape (n,)
        What was measured, in physical units; the state itself.
    t_ns : int
        Monotonic time of the reading; 0 in a simulation. A reading with the time of the one before
        is stale.
    """

    y: Vector
    t_ns: int = 0


class PlantAdapter(Protocol):
    """All that the plant service knows of a plant."""

    def start(self, seed: int | None) -> Sample:
        """Reset or connect; the first reading. ``seed`` is for plants with chance of their own."""

    def apply(self, u: Vector) -> None:
        """Actuate ``u`` now, shape (m,), and return at once."""

    def sample(self) -> Sample:
        """The reading at the end of the step that :meth:`apply` began."""

    def safe(self) -> None:
        """Go to the safe state. Must not raise; a second call does no harm."""

    def close(self) -> None:
        """Let go of everything; the adapter is not used again."""


class Stepped(Protocol):
    """What most simulations are: one call a step."""

    def reset(self, seed: int | None, /) -> Sequence[float]:
        """Begin anew; the initial state."""

    def step(self, u: Vector, period_s: float, /) -> Sequence[float]:
        """The state ``period_s`` seconds on, with ``u`` held."""


@runtime_checkable
class Resumable(Protocol):
    """Optional: a plant whose reading is all its state, so that it can go on from one.

    Such a plant goes on where its journal stands when its process has died. Any other begins a new
    session.
    """

    def resume(self, y: Vector, k: int) -> None:
        """Stand at reading ``y``, ``k`` periods after the start."""


@runtime_checkable
class Displaceable(Protocol):
    """Optional: a plant whose state a disturbance may be added to."""

    def displace(self, d: Vector) -> Vector:
        """Add ``d`` to the state, in physical units; the reading after it."""


def stepped(plant: Any, name: str) -> Stepped:
    """``plant``, once it has both methods of :class:`Stepped`.

    Raises
    ------
    PlantError
    """
    for method in ("reset", "step"):
        if not callable(getattr(plant, method, None)):
            raise PlantError(
                f"{name}: has no method {method}, expected reset(seed) and step(u, period_s)"
            )
    found: Stepped = plant
    return found


class SimulatedPlant:
    """A :class:`PlantAdapter` of a :class:`Stepped` plant: the step is made when it is read.

    Parameters
    ----------
    plant : Stepped
    period_s : float
    """

    def __init__(self, plant: Stepped, period_s: float) -> None:
        self.plant = plant
        self._period_s = period_s
        self._u: Vector | None = None

    def start(self, seed: int | None) -> Sample:
        """Reset the plant."""
        return Sample(floats(self.plant.reset(seed)))

    def apply(self, u: Vector) -> None:
        """Keep ``u`` for the step to come."""
        self._u = u

    def sample(self) -> Sample:
        """Make the step."""
        if self._u is None:
            raise PlantError("the plant was read before an input was applied")
        return Sample(floats(self.plant.step(self._u, self._period_s)))

    def safe(self) -> None:
        """Call the plant's own method, if it has one."""
        safe = getattr(self.plant, "safe", None)
        if safe is not None:
            safe()

    def close(self) -> None:
        """Call the plant's own method, if it has one."""
        close = getattr(self.plant, "close", None)
        if close is not None:
            close()


def floats(values: Sequence[float]) -> Vector:
    """The reading as plain floats, whatever array or list the plant returned.

    Raises
    ------
    PlantError
    """
    try:
        return tuple([float(v) for v in values])
    except (TypeError, ValueError):
        raise PlantError(f"got the reading {values!r}, expected a sequence of numbers") from None
