"""`ghost`: reports a quiet plant of its own, moved by what Eve believes was applied."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from attacker_service.base import UNKNOWN, AttackError, LoopModel, Observation, SensorAttack
from attacker_service.base import Options as CommonOptions
from attacker_service.sight import Sight, chosen
from protocol.arrays import Array, Integers
from protocol.scenario.attack import Knowable


class Ghost(SensorAttack):
    """x'(k+1) = A x'(k) + B u_b' + d', with d' within D_c.

    The controller answers a constant part of d', so that the true plant runs off the other way. b'
    is the coin that Eve holds, else the one that fits to what Eve sees of the plant, else a
    guess, evenly among the candidates. Without an offer no input moved it.
    """

    class Options(CommonOptions):
        """``push``: the constant part of d', as a share of D_c, along ``direction``.

        All states alike where no direction is given. ``share``: of D_c, what is drawn besides.
        """

        push: Annotated[float, Field(ge=0, le=1)] = 0.9
        share: Annotated[float, Field(ge=0, le=1)] = 0.1
        direction: tuple[float, ...] = ()

    name: ClassVar[str] = "ghost"
    knows: ClassVar[frozenset[Knowable]] = frozenset({"model", "bus"})
    options: Options

    def __init__(
        self, model: LoopModel | None, options: Mapping[str, Any], rng: np.random.Generator
    ) -> None:
        super().__init__(model, options, rng)
        sees, n = self.options.sees, len(self.model.A)
        if self.options.push + self.options.share > 1:
            raise AttackError(f"attack.push: {self.name}: expected at most 1 together with share")
        way = np.asarray(self.options.direction or (1.0,) * n)
        if way.shape != (n,) or not way.any():
            text = f"got {way.tolist()}, expected {n} numbers, one not zero"
            raise AttackError(f"attack.direction: {text}")
        self._push = self.options.push * way / self.model.gauge(way)
        self._sight = None if sees is None else Sight(self.model, sees)

    def watch(self, reading: Array) -> None:
        """Note where the plant stands."""
        if self._sight is not None:
            self._sight.stand(reading)

    def sensor(self, observed: Observation) -> Array:
        """The next state of the quiet plant."""
        d = self._disturbance(observed.shown.shape)
        if observed.candidates is None:
            u = np.zeros((*observed.shown.shape[:-1], self.model.B.shape[1]))
        else:
            u = chosen(observed.candidates, self._coins(observed, observed.candidates))
        if self._sight is not None and observed.seen is not None:
            self._sight.step(u, observed.seen)
        return self.model.predict(observed.shown, u) + d

    def _coins(self, observed: Observation, candidates: Array) -> Integers:
        """What Eve takes for applied in each run."""
        runs, size = candidates.shape[:-2], candidates.shape[-2]
        if self._sight is not None and observed.seen is not None:
            guess: Integers = self._sight.coins(candidates, observed.seen)
        else:
            guess = self.rng.integers(size, size=runs)
        held = np.full(runs, UNKNOWN) if observed.coins is None else observed.coins
        return np.where(held == UNKNOWN, guess, held)

    def _disturbance(self, shape: tuple[int, ...]) -> Array:
        """What passes for a disturbance."""
        if not self.options.share:
            return np.broadcast_to(self._push, shape)
        way = self.rng.standard_normal(shape)
        far = self.options.share * self.rng.random(shape[:-1]) ** (1 / shape[-1])
        drawn: Array = way * (far / self.model.gauge(way))[..., None]
        return self._push + drawn
