"""The linear plant x+ = A x + B u, in the arithmetic of the agreement test."""

from operator import add

from protocol.agreement import predict
from protocol.vectors import Matrix, Vector


class Linear:
    """A :class:`~plant_service.adapters.base.Stepped` plant of two matrices.

    Parameters
    ----------
    A, B : tuple of tuple of float, shapes (n, n) and (n, m)
    initial_state : tuple of float, shape (n,)
    """

    def __init__(self, A: Matrix, B: Matrix, initial_state: Vector) -> None:
        self._A, self._B = A, B
        self._initial_state = initial_state
        self._x = initial_state

    def reset(self, seed: int | None) -> Vector:  # noqa: ARG002
        """Stand at the initial state."""
        self._x = self._initial_state
        return self._x

    def step(self, u: Vector, period_s: float) -> Vector:  # noqa: ARG002
        """A x + B u."""
        self._x = predict(self._A, self._B, self._x, u)
        return self._x

    def displace(self, d: Vector) -> Vector:
        """Add ``d`` to the state."""
        self._x = tuple(map(add, self._x, d))
        return self._x

    def resume(self, y: Vector, k: int) -> None:  # noqa: ARG002
        """Stand at ``y``."""
        self._x = y
