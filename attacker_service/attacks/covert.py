"""`covert`: adds to the input, and takes its effect off the measurement (Smith, 2015)."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from attacker_service.base import AttackError, BusAttack, LoopModel
from attacker_service.base import Options as CommonOptions
from protocol.arrays import Array, Flags
from protocol.scenario.attack import Knowable


class Covert(BusAttack):
    """u_a on top of every candidate; e(k+1) = A e(k) + B u_a is taken off x(k+1).

    Where a candidate would leave U, which the plant refuses, as much of u_a is added as fits to all
    of them. A step whose offer was not applied moves e by A alone, as where the fallback is zero.
    Under another one a part of the attack shows. No alarm comes of it: the controller tests
    no such step, and each step that it tests moves e by the model, whatever e was.
    """

    class Options(CommonOptions):
        """``input``: u_a, a number for each input; one number stands for all."""

        input: float | tuple[float, ...] = 0.3

    name: ClassVar[str] = "covert"
    knows: ClassVar[frozenset[Knowable]] = frozenset({"model", "bus"})
    options: Options

    def __init__(
        self, model: LoopModel | None, options: Mapping[str, Any], rng: np.random.Generator
    ) -> None:
        super().__init__(model, options, rng)
        m = self.model.B.shape[1]
        given = np.asarray(self.options.input, float)
        if given.ndim and given.shape != (m,):
            raise AttackError(f"attack.input: got {given.tolist()}, expected {m} numbers, or one")
        self._u = np.broadcast_to(given, (m,))
        self._added: tuple[int, Array] | None = None
        self._off: tuple[int, Array] | None = None

    def toward_plant(self, k: int, candidates: Array) -> Array:
        """Every candidate with u_a on top."""
        H, h = self.model.inputs_H, self.model.inputs_h
        pushes = H @ self._u
        room = (h - candidates @ H.T)[..., pushes > 0] / pushes[pushes > 0]
        fits = np.clip(room.min((-2, -1), initial=1.0), 0.0, 1.0)
        added = fits[..., None] * self._u
        self._added = k, added
        found: Array = candidates + added[..., None, :]
        return found

    def toward_controller(self, k: int, x: Array, applied: Flags) -> Array:
        """x(k) without what Eve has done to it."""
        if self._off is None:
            self._off = k - 1, np.zeros_like(x)
        at, e = self._off
        if k > at:
            e = np.linalg.matrix_power(self.model.A, k - at) @ e[..., None]
            e = e[..., 0]
            if self._added is not None and self._added[0] == k - 1:
                e = e + np.where(applied[..., None], self._added[1] @ self.model.B.T, 0.0)
            self._off = k, e
        return x - e
