"""Filters: what stands between a plant and its end of the link, in the order of a reading's way.

Noise, outputs and an attack are filters: each is asked about every reading and every input, and
hears the messages that pass beside the plant. What a filter does not say anything about passes as
it is.
"""

from collections.abc import Sequence
from operator import add, sub

from protocol.box_observer import BoxObserver
from protocol.messages import FieldMessage
from protocol.scenario import Scenario, SensorNoise
from protocol.streams import Stream
from protocol.vectors import Vector


class Filter:
    """Lets everything pass.

    Attributes
    ----------
    acts : bool
        It keeps something that stands in no journal: a step through it cannot be made twice.
    listens : bool
        It wants to hear the messages that pass beside the plant; there they go on as they came.
    """

    acts = False
    listens = False

    def sensor(self, k: int, x: Vector, y: Vector) -> Vector:  # noqa: ARG002
        """What is read of x(k), of which the filter before read ``y``."""
        return y

    def known(self, k: int, x: Vector, y: Vector) -> Vector:  # noqa: ARG002
        """x(k), as it follows from the reading ``y`` that the filter lets out."""
        return x

    def actuator(self, k: int, u: Vector) -> Vector:  # noqa: ARG002
        """What is applied in step k where ``u`` was to be."""
        return u

    def incoming(self, kind: type[FieldMessage], payload: bytes) -> bytes:  # noqa: ARG002
        """A message on its way to the plant, as it goes on."""
        return payload

    def outgoing(self, kind: type[FieldMessage], payload: bytes) -> bytes:  # noqa: ARG002
        """A message on its way from the plant, as it goes on."""
        return payload

    def fault(self) -> str:
        """What has gone wrong with it since the last time that it was asked; empty: nothing."""
        return ""

    def close(self) -> None:
        """It is used no more."""


class Noise(Filter):
    """Sensors with noise: y(k) + n(k).

    n(k) is draw k of a seeded stream: so it stands in no journal, and is the same after a restart.
    Where the reading is of the whole state, that is known again from the reading: y(k) - n(k).

    Parameters
    ----------
    noise : SensorNoise
    draws : Stream
        Of as many uniform numbers as there are readings.
    whole : bool
        Whether the whole state is read.
    """

    def __init__(self, noise: SensorNoise, draws: Stream, *, whole: bool) -> None:
        self._noise, self._draws, self._whole = noise, draws, whole

    def sensor(self, k: int, x: Vector, y: Vector) -> Vector:  # noqa: ARG002
        """y(k) + n(k)."""
        return tuple(map(add, y, self._noise.drawn(self._draws.at(k))))

    def known(self, k: int, x: Vector, y: Vector) -> Vector:
        """y(k) - n(k), where the whole state is read."""
        return tuple(map(sub, y, self._noise.drawn(self._draws.at(k)))) if self._whole else x


class Outputs(Filter):
    """Sensors of some outputs alone: C x(k)."""

    def __init__(self, observer: BoxObserver) -> None:
        self._observer = observer

    def sensor(self, k: int, x: Vector, y: Vector) -> Vector:  # noqa: ARG002
        """C x(k)."""
        return self._observer.read(x)


def sensors_of(scenario: Scenario, draws: Stream) -> list[Filter]:
    """The simulated sensors of a scenario's plant; none where its state is read as it is.

    Parameters
    ----------
    scenario : Scenario
    draws : Stream
        Of as many uniform numbers as there are readings; draw k belongs to y(k).
    """
    observer, noise = scenario.observer, scenario.plant.noise
    found: list[Filter] = [] if observer is None else [Outputs(observer)]
    return found if noise is None else [*found, Noise(noise, draws, whole=observer is None)]


def read_through(filters: Sequence[Filter], k: int, x: Vector) -> tuple[Vector, Vector]:
    """What is read of x(k), and x(k) as it is known from then on."""
    y = x
    for one in filters:
        y = one.sensor(k, x, y)
        x = one.known(k, x, y)
    return y, x
