"""The one wrapper of every plant: units, operating point, scaling, limits, finiteness.

x = (y - y_operating) / scale and u_physical = u_operating + scale u: controller, wire and journal
know deviations, the plant knows physical units, and this is where they meet.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from operator import add
from typing import TypeVar

from plant_service.adapters.base import (
    Displaceable,
    PlantAdapter,
    PlantError,
    Resumable,
    Sample,
    SimulatedPlant,
)
from protocol.agreement import Gauge
from protocol.link.fallback import clip
from protocol.vectors import Vector

_R = TypeVar("_R")


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """Where deviations are counted from, and in which unit.

    Parameters
    ----------
    state, input : tuple of float, shapes (n,) and (m,)
        In physical units.
    state_scale, input_scale : tuple of float, shapes (n,) and (m,)
        Physical units to one unit of deviation, positive.
    """

    state: Vector
    input: Vector
    state_scale: Vector
    input_scale: Vector

    @classmethod
    def origin(cls, n: int, m: int) -> "OperatingPoint":
        """Deviations are the physical values."""
        return cls((0.0,) * n, (0.0,) * m, (1.0,) * n, (1.0,) * m)

    def deviation(self, y: Vector) -> Vector:
        """x of a reading."""
        rows = zip(y, self.state, self.state_scale, strict=True)
        return tuple([(v - at) / scale for v, at, scale in rows])

    def reading(self, x: Vector) -> Vector:
        """The reading of x."""
        rows = zip(x, self.state, self.state_scale, strict=True)
        return tuple([at + scale * v for v, at, scale in rows])

    def physical_input(self, u: Vector) -> Vector:
        """What the plant is to be actuated with."""
        rows = zip(u, self.input, self.input_scale, strict=True)
        return tuple([at + scale * v for v, at, scale in rows])


class Operated:
    """A plant in deviations.

    After any failure the plant is told to be safe, and stays so: every later call but
    :meth:`safe` and :meth:`close` fails.

    Parameters
    ----------
    adapter : PlantAdapter
    point : OperatingPoint
    inputs : Gauge
        Of U, in deviations; what is applied is clipped to it.
    name : str
        For messages.
    limits : tuple of (low, high), optional
        Range of each reading in physical units; one outside is a failure.
    """

    def __init__(
        self,
        adapter: PlantAdapter,
        point: OperatingPoint,
        inputs: Gauge,
        *,
        name: str = "plant",
        limits: tuple[tuple[float, float], ...] | None = None,
    ) -> None:
        self.adapter = adapter
        core = _core(adapter)
        self._resumable = core if isinstance(core, Resumable) else None
        self._displaceable = core if isinstance(core, Displaceable) else None
        self.point = point
        self._inputs = inputs
        self._name = name
        self._limits = limits
        self._t_ns = -1
        self._fault = ""

    @property
    def fault(self) -> str:
        """Why the plant is in its safe state, or nothing."""
        return self._fault

    @property
    def device(self) -> bool:
        """Whether it moves by itself, so that a step takes the time it takes."""
        return not isinstance(self.adapter, SimulatedPlant)

    @property
    def resumable(self) -> bool:
        """Whether the plant can go on from a reading."""
        return self._resumable is not None

    @property
    def displaceable(self) -> bool:
        """Whether a disturbance can be added to the state."""
        return self._displaceable is not None

    def start(self, seed: int | None) -> Vector:
        """Reset or connect; x(0).

        Raises
        ------
        PlantError
        """
        return self._checked(self._guarded("start", lambda: self.adapter.start(seed)))

    def resume(self, x: Vector, k: int) -> None:
        """Go on from x(k); only where :attr:`resumable`."""
        core = self._resumable
        assert core is not None
        self._guarded("resume", lambda: core.resume(self.point.reading(x), k))

    def apply(self, u: Vector, d: Vector | None = None) -> Vector:
        """Actuate; returns what was applied, ``u`` clipped to U.

        ``d`` disturbs the input on its way, beyond U if need be, and is nobody's to know.

        Raises
        ------
        PlantError
        """
        applied = clip(u, self._inputs) if self._inputs(u) > 1 else u
        arrived = applied if d is None else tuple(map(add, applied, d))
        physical = self.point.physical_input(arrived)
        self._guarded("apply", lambda: self.adapter.apply(physical))
        return applied

    def sample(self, d: Vector | None = None) -> Vector:
        """x at the end of the step, with the disturbance ``d`` (a deviation) added to the state.

        Raises
        ------
        PlantError
            Also for a stale, short, infinite or out-of-range reading.
        """
        sample = self._guarded("sample", self.adapter.sample)
        if d is not None:
            core = self._displaceable
            assert core is not None
            rows = zip(d, self.point.state_scale, strict=True)
            physical = tuple([v * scale for v, scale in rows])
            sample = Sample(self._guarded("displace", lambda: core.displace(physical)), sample.t_ns)
        return self._checked(sample)

    def safe(self, why: str = "it was asked to") -> None:
        """Send the plant to its safe state; it stays there."""
        self._fault = self._fault or why
        try:
            self.adapter.safe()
        except Exception as error:
            self._fault += f"; and its safe() failed: {error}"

    def close(self) -> str:
        """Close the plant. Returns in one line what its code raised, or nothing.

        It does not raise: a failure here must not hide the one that led here, nor keep files open.
        """
        try:
            self.adapter.close()
        except Exception as error:
            text = error if isinstance(error, PlantError) else f"{type(error).__name__}: {error}"
            return f"{self._name}: close: {' '.join(str(text).split())}"
        return ""

    def _guarded(self, what: str, call: "Callable[[], _R]") -> _R:
        """Call into the plant's own code: whatever it raises becomes one line, and it is safe."""
        if self._fault:
            raise PlantError(f"{self._name}: is in its safe state: {self._fault}")
        try:
            return call()
        except (Exception, SystemExit) as error:
            text = error if isinstance(error, PlantError) else f"{type(error).__name__}: {error}"
            self._fail(f"{what}: {' '.join(str(text).split())}", error)
            raise

    def _fail(self, text: str, cause: BaseException | None = None) -> None:
        self.safe(text)
        raise PlantError(f"{self._name}: {self._fault}") from cause

    def _checked(self, sample: Sample) -> Vector:
        y, t_ns = sample
        n = len(self.point.state)
        if len(y) != n:
            self._fail(f"got {len(y)} readings, expected {n}")
        if not all(map(isfinite, y)):
            self._fail(f"got the reading {list(y)}, expected finite numbers")
        if t_ns:
            if t_ns <= self._t_ns:
                self._fail(f"got a reading of time {t_ns} ns again, expected a newer one")
            self._t_ns = t_ns
        for i, (v, (low, high)) in enumerate(zip(y, self._limits or (), strict=False)):
            if not low <= v <= high:
                self._fail(f"got {v!r} as reading {i + 1}, expected {low!r} to {high!r}")
        return self.point.deviation(y)


def _core(adapter: PlantAdapter) -> object:
    """The object that has the optional methods: the stepped plant, or the adapter itself."""
    return adapter.plant if isinstance(adapter, SimulatedPlant) else adapter
