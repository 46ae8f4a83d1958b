"""What every attack is: told what Eve holds, it says what is put in place of the truth.

All of it is NumPy by element: the leading axes ``...`` are runs, none in a live run. An attack
does no input or output, draws from the generator that it is handed, and keeps what it needs.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from protocol.arrays import Array, Flags, Integers
from protocol.scenario import Scenario
from protocol.scenario.attack import Knowable, Place
from protocol.wrong_fields import wrong_fields

UNKNOWN: Final = -1
"""In place of a coin that Eve does not know."""


class AttackError(Exception):
    """An attack that cannot be made of what it is given; one line, from the field's name on."""


@dataclass(frozen=True, slots=True)
class LoopModel:
    """What one who knows the loop knows: f_c, D_c and U.

    D_c is the defender's, so that no attack is weaker than it need be; D_e would be too large.

    Parameters
    ----------
    A, B : ndarray, shapes (n, n) and (n, m)
    disturbance_H, disturbance_h : ndarray, shapes (rows, n) and (rows,)
        D_c = { d : H d <= h }.
    inputs_H, inputs_h : ndarray, shapes (rows, m) and (rows,)
        U = { u : H u <= h }.
    """

    A: Array
    B: Array
    disturbance_H: Array
    disturbance_h: Array
    inputs_H: Array
    inputs_h: Array

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """The model of a scenario's defender."""
        rows = (*scenario.defender.disturbance.rows(), *scenario.control.inputs.rows())
        return cls(*(np.asarray(part, float) for part in (scenario.A, scenario.B, *rows)))

    def predict(self, x: Array, u: Array) -> Array:
        """A x + B u, shape (..., n), for x of shape (..., n) and u of shape (..., m)."""
        return x @ self.A.T + u @ self.B.T

    def gauge(self, d: Array) -> Array:
        """The smallest t >= 0 with d in t D_c, shape (...,)."""
        rows: Array = d @ self.disturbance_H.T / self.disturbance_h
        found: Array = np.maximum(rows.max(-1), 0.0)
        return found

    @property
    def half_widths(self) -> Array:
        """How far D_c reaches along each axis, on its nearer side, shape (n,)."""
        axes = np.eye(len(self.A))
        return 1 / np.maximum(self.gauge(axes), self.gauge(-axes))


@dataclass(frozen=True, slots=True)
class Observation:
    """What Eve has at the reading x(k).

    Parameters
    ----------
    k : int
    shown : ndarray, shape (..., n)
        What was reported as x(k-1); the truth, up to the onset.
    candidates : ndarray, shape (..., M, m), optional
        The inputs offered in step k-1; None where Eve does not hear the bus, or no offer was made.
    coins : ndarray of int, shape (...,), optional
        The candidate that Eve believes applied in step k-1; :data:`UNKNOWN` where Eve has no key.
    seen : ndarray, shape (..., n), optional
        x(k) with Eve's noise; None where Eve does not see the plant.
    """

    k: int
    shown: Array
    candidates: Array | None = None
    coins: Integers | None = None
    seen: Array | None = None


class Options(BaseModel):
    """What may stand in ``[attack]`` besides kind, place, onset and ``knows``.

    Parameters
    ----------
    sees : float, optional
        Standard deviation of the noise with which Eve sees each state; None: Eve does not see them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sees: Annotated[float, Field(ge=0)] | None = None


class Attack(ABC):
    """Base of all attacks.

    Attributes
    ----------
    name : str
    at : {"sensor", "bus", "actuator"}
        Where it stands.
    knows : frozenset of str
        What it cannot do without, of ``model``, ``bus`` and ``coins``.
    Options : type
        Its own options, with defaults.

    Parameters
    ----------
    model : LoopModel or None
        None where Eve does not know it.
    options : mapping
    rng : numpy.random.Generator

    Raises
    ------
    AttackError
        When an option is wrong, or the attack needs what it is not given.
    """

    name: ClassVar[str]
    at: ClassVar[Place]
    knows: ClassVar[frozenset[Knowable]] = frozenset()
    Options: ClassVar[type[Options]] = Options

    def __init__(
        self, model: LoopModel | None, options: Mapping[str, Any], rng: np.random.Generator
    ) -> None:
        try:
            self.options = self.Options.model_validate(dict(options))
        except ValidationError as error:
            raise AttackError(f"attack.{wrong_fields(error)[0]} ({self.name})") from None
        if "model" in self.knows and model is None:
            raise AttackError(f"attack.knows: {self.name} needs 'model'")
        self._model = model
        self.rng = rng

    @property
    def model(self) -> LoopModel:
        """The model, for an attack that needs it."""
        assert self._model is not None
        return self._model


class SensorAttack(Attack):
    """Reports another reading in place of the true one, from the onset on."""

    at: ClassVar[Place] = "sensor"

    def watch(self, reading: Array) -> None:
        """Before the onset: ``reading``, shape (..., n), is reported as it is."""

    @abstractmethod
    def sensor(self, observed: Observation) -> Array:
        """What is reported as x(k), shape (..., n)."""


class ActuatorAttack(Attack):
    """Applies another input in place of the chosen one, from the onset on."""

    at: ClassVar[Place] = "actuator"

    @abstractmethod
    def actuator(self, u: Array) -> Array:
        """What is applied, shape (..., m), where ``u`` was chosen."""

    def watch_input(self, u: Array) -> None:
        """Before the onset: ``u``, shape (..., m), is applied as it is."""


class BusAttack(Attack):
    """Rewrites both directions of the field bus, from the onset on."""

    at: ClassVar[Place] = "bus"

    @abstractmethod
    def toward_plant(self, k: int, candidates: Array) -> Array:
        """The candidates of step k that the plant gets, shape (..., M, m)."""

    @abstractmethod
    def toward_controller(self, k: int, x: Array, applied: Flags) -> Array:
        """The x(k) that the controller gets, shape (..., n).

        ``applied``, shape (...,): whether the offer of step k-1 was.
        """
