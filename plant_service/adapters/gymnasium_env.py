"""A Gymnasium environment as a plant; needs the extra ``wyner[gym]``."""

import inspect
import random
from typing import TYPE_CHECKING, Any, Final

from plant_service.adapters.base import PlantError, floats
from protocol.vectors import Vector
from runtime.errors import needs

if TYPE_CHECKING:
    import gymnasium

OLD: Final = "expected Gymnasium's interface of version 0.26 or later"

NUMPY_SEEDS: Final = 2**32
"""How many seeds numpy's global generator has."""


class Environment:
    """A :class:`~plant_service.adapters.base.Stepped` plant of a Gymnasium environment.

    The environment is taken without its wrappers: no time limit ends an episode and no checker
    rounds an action. Where it has a settable ``state`` attribute the plant can be resumed and
    disturbed (see :class:`StateEnvironment`).

    Parameters
    ----------
    env : gymnasium.Env
    """

    def __init__(self, env: "gymnasium.Env[Any, Any]") -> None:
        self.env = env.unwrapped

    def reset(self, seed: int | None) -> Vector:
        """Begin an episode.

        An environment may draw from the generators of numpy and Python that all code shares: they
        are seeded too.
        """
        import numpy as np

        if seed is not None:
            np.random.seed(seed % NUMPY_SEEDS)
            random.seed(seed)
        try:
            inspect.signature(self.env.reset).bind(seed=seed)
        except TypeError:
            raise PlantError(f"reset takes no seed, {OLD}: reset(seed=..., options=...)") from None
        found = self.env.reset(seed=seed)
        if not isinstance(found, tuple) or len(found) != 2:
            raise PlantError(f"reset returns no observation with its info, {OLD}: two values")
        return self._reading(found[0])

    def step(self, u: Vector, period_s: float) -> Vector:  # noqa: ARG002
        """One step of the environment; its reward is not looked at.

        Raises
        ------
        PlantError
            When the environment says that it has come to an end.
        """
        import numpy as np

        found: Any = self.env.step(np.array(u))
        if not isinstance(found, tuple) or len(found) != 5:
            raise PlantError(
                f"step returns other than five values, {OLD}: observation, reward, terminated, "
                "truncated, info"
            )
        observation, _, terminated, truncated, _ = found
        if terminated or truncated:
            raise PlantError("the environment's episode has ended")
        return self._reading(observation)

    @property
    def actions(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest value of each input.

        Raises
        ------
        PlantError
            When inputs are not vectors of real numbers.
        """
        import gymnasium

        space = self.env.action_space
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise PlantError(f"its action space is {space}, expected a Box of one dimension")
        return tuple(zip(space.low.tolist(), space.high.tolist(), strict=True))

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def _reading(self, observation: Any) -> Vector:
        return floats(observation)


class StateEnvironment(Environment):
    """An environment whose state is an attribute, read and set in full precision.

    Parameters
    ----------
    env : gymnasium.Env
    attribute : str
        Of the unwrapped environment, an array of shape (n,).
    initial_state : tuple of float, shape (n,), optional
        Set after each reset; else the environment's own.
    """

    def __init__(
        self,
        env: "gymnasium.Env[Any, Any]",
        attribute: str,
        initial_state: Vector | None = None,
    ) -> None:
        super().__init__(env)
        self._attribute = attribute
        self._initial_state = initial_state

    def reset(self, seed: int | None) -> Vector:
        """Begin an episode, at the initial state where one is given."""
        reading = super().reset(seed)
        if self._initial_state is None:
            return reading
        self._set(self._initial_state)
        return self._initial_state

    def displace(self, d: Vector) -> Vector:
        """Add ``d`` to the state."""
        y = tuple([v + e for v, e in zip(self._reading(None), d, strict=True)])
        self._set(y)
        return y

    def resume(self, y: Vector, k: int) -> None:  # noqa: ARG002
        """Stand at ``y``."""
        self._set(y)

    def _set(self, y: Vector) -> None:
        import numpy as np

        setattr(self.env, self._attribute, np.array(y))

    def _reading(self, observation: Any) -> Vector:  # noqa: ARG002
        state = getattr(self.env, self._attribute, None)
        if state is None:
            raise PlantError(f"the environment has no attribute {self._attribute!r}")
        return tuple([float(v) for v in state])


def make(
    id_: str,
    state: str | None,
    initial_state: Vector | None,
    period_s: float,
    arguments: dict[str, Any] | None = None,
) -> Environment:
    """The environment registered as ``id_``.

    Raises
    ------
    PlantError
        When Gymnasium is not installed, knows no such environment, or its step is not the period.
    """
    try:
        import gymnasium
    except ModuleNotFoundError:
        raise PlantError(needs("gymnasium", "gymnasium")) from None
    try:
        env = gymnasium.make(id_, disable_env_checker=True, **(arguments or {}))
    except Exception as error:
        raise PlantError(f"{id_}: {' '.join(str(error).split())}") from error
    dt = getattr(env.unwrapped, "dt", None)
    if isinstance(dt, float) and abs(dt - period_s) > 1e-9 * period_s:
        env.close()
        raise PlantError(f"{id_}: its step is {dt!r} s, got a period_s of {period_s!r}")
    if state is None:
        return Environment(env)
    return StateEnvironment(env, state, initial_state)
