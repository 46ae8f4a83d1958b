"""Plants of one's own: what the plant service asks of a plant, and the kinds that are built in.

A plant is one of three things: an object with ``reset`` and ``step`` (:class:`Stepped`), a
function dx/dt = f(t, x, u) (:mod:`plant_service.adapters.ode`), or a device that is actuated and
read (:class:`PlantAdapter`). Whatever it is, :class:`Operated` turns it into deviations from the
operating point, and nothing above knows units.
"""

from plant_service.adapters.base import (
    Displaceable,
    PlantAdapter,
    PlantError,
    Resumable,
    Sample,
    SimulatedPlant,
    Stepped,
)
from plant_service.adapters.operated import Operated, OperatingPoint
from protocol.vectors import Vector

__all__ = [
    "Displaceable",
    "Operated",
    "OperatingPoint",
    "PlantAdapter",
    "PlantError",
    "Resumable",
    "Sample",
    "SimulatedPlant",
    "Stepped",
    "Vector",
]
