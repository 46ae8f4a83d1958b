"""A plant dx/dt = f(t, x, u), stepped by the classical Runge-Kutta method of fourth order.

There is one solver and it has one setting, the number of substeps: a run repeats to the last bit.
"""

from operator import add

from plant_service.adapters.base import PlantError
from protocol.integration import Dynamics, runge_kutta_step
from protocol.vectors import Vector


class Ode:
    """A :class:`~plant_service.adapters.base.Stepped` plant of a function.

    Parameters
    ----------
    dynamics : callable
        (t, x, u) -> dx/dt in physical units; python-control's ``system.dynamics`` is one.
    initial_state : tuple of float, shape (n,)
        In physical units.
    period_s : float
        Only :meth:`resume` needs it, for the time.
    substeps : int
        Runge-Kutta steps to a period.
    """

    def __init__(
        self, dynamics: Dynamics, initial_state: Vector, period_s: float, substeps: int = 10
    ) -> None:
        self._dynamics = dynamics
        self._initial_state = initial_state
        self._period_s = period_s
        self._substeps = substeps
        self._x = initial_state
        self._k = 0

    def reset(self, seed: int | None) -> Vector:  # noqa: ARG002
        """Stand at the initial state, at time 0."""
        self._x, self._k = self._initial_state, 0
        return self._x

    def step(self, u: Vector, period_s: float) -> Vector:
        """The state a period on; the time is k periods, not a sum that drifts."""
        h = period_s / self._substeps
        t = self._k * period_s
        x = self._x
        try:
            for i in range(self._substeps):
                x = runge_kutta_step(self._dynamics, t + i * h, x, u, h)
        except (ValueError, TypeError) as error:
            raise PlantError(f"the dynamics at x = {list(self._x)}: {error}") from error
        self._x, self._k = x, self._k + 1
        return x

    def displace(self, d: Vector) -> Vector:
        """Add ``d`` to the state."""
        self._x = tuple(map(add, self._x, d))
        return self._x

    def resume(self, y: Vector, k: int) -> None:
        """Stand at ``y``, ``k`` periods after the start."""
        self._x, self._k = y, k
