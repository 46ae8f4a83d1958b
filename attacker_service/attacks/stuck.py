"""`stuck`: the actuator stays where it was."""

from typing import ClassVar

import numpy as np

from attacker_service.base import ActuatorAttack, AttackError
from attacker_service.base import Options as CommonOptions
from protocol.arrays import Array


class Stuck(ActuatorAttack):
    """The last input before the onset, or ``value``, whatever is chosen."""

    class Options(CommonOptions):
        """``value``: the input at which it is stuck; the last one before where none is given."""

        value: tuple[float, ...] | None = None

    name: ClassVar[str] = "stuck"
    options: Options
    _last: Array | None = None

    def watch_input(self, u: Array) -> None:
        """Note it."""
        self._last = u

    def actuator(self, u: Array) -> Array:
        """The input at which it is stuck."""
        value = self.options.value
        if value is None:
            self._last = u if self._last is None else self._last
            return self._last
        if len(value) != u.shape[-1]:
            raise AttackError(f"attack.value: got {len(value)} inputs, expected {u.shape[-1]}")
        return np.broadcast_to(np.asarray(value), u.shape)
