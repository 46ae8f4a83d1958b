"""`fitted-box`: takes the nearest candidate in the shape of D_c, which she finds.

`nearest-centre` measures candidates in the shape of D_e. That names every key where D_e is a
multiple of D_c, and not where it is wider in one direction than in another: a coordinate that tells
nothing of the input may then outweigh the one that decides. She needs no D_c for more. Whatever was
applied left its disturbance in one set; so she looks for the smallest set, with facets along those
of D_e, that holds one residual of every step (:mod:`tap_service.inference.fitted_shape`), and
decodes as `list-decoder` does. Where outputs alone are read no step shows its residual: she takes
the widths under which the readings are likeliest.
"""

from typing import ClassVar

import numpy as np

from protocol.agreement import Gauge, predict
from protocol.arrays import Array
from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Model
from tap_service.eavesdroppers.reading import Reading
from tap_service.inference.fitted_shape import fitted_widths
from tap_service.inference.inferred import Inferred, InferredStep
from tap_service.inference.output_fit import refitted
from tap_service.inference.output_model import OutputModel


class FittedBox(Reading):
    """Takes the nearest candidate in the shape that she found."""

    name: ClassVar[str] = "fitted-box"

    first: ClassVar[int] = 8

    def __init__(self, knowledge: Knowledge, *, live: bool = True) -> None:
        super().__init__(knowledge, live=live)
        self.model = self._told = Model.of(knowledge, self.name)
        assert knowledge.disturbance_H is not None
        assert knowledge.disturbance_h is not None
        self._H, self._h = knowledge.disturbance_H, np.array(knowledge.disturbance_h)
        self.widths: Array = np.ones(len(self._h))
        """Of what she found, along each facet of D_e and in units of D_e."""

    def _along(self, t: Transition) -> Array | None:
        """How far each candidate of a step is from what was heard, along each facet of D_e."""
        if t.x is None or t.candidates is None or t.x_next is None:
            return None
        told = self._told
        centres = t.predictions or [predict(told.A, told.B, t.x, u) for u in t.candidates]
        along: Array = (np.array(t.x_next) - np.array(centres)) @ np.array(self._H).T / self._h
        return along

    def _measured(self, along: Array) -> Array:
        """The gauges of a step in the shape found so far."""
        return np.asarray(np.maximum(0.0, (along / self.widths).max(axis=1)))

    def gauges(self, transition: Transition) -> list[float] | None:
        """Of each candidate in the shape found so far."""
        along = self._along(transition)
        found: list[float] | None = None if along is None else self._measured(along).tolist()
        return found

    def infer(self) -> Inferred:
        """The gauges of the steps that were heard whole, where the largest possible one is 1."""
        heard = [self._along(t) for t in self.kept]
        whole = [along for along in heard if along is not None]
        if whole:
            self.widths = fitted_widths(np.array(whole))
        possible = [self._measured(along).max() for along in whole if (along <= 1.0).all()]
        top = max(possible, default=1.0)
        steps = [
            InferredStep(t, None if along is None else self._sample(along, top))
            for t, along in zip(self.kept, heard, strict=True)
        ]
        return Inferred(steps, (0.0, 1.0))

    def _sample(self, along: Array, top: float) -> Array:
        """Gauges over the largest possible one; no key can be agreed where D_e excludes one."""
        gauges = self._measured(along) / top
        if (along > 1.0).any():
            gauges[gauges.argmax()] = np.inf
        return gauges[None]

    def output_model(self) -> OutputModel | None:
        """The told model, with the width of each coordinate of the disturbance fitted."""
        assert isinstance(self._told, OutputModel)
        return refitted(self._told, self.kept, each=True)

    @property
    def gauge(self) -> Gauge:
        """The set that she found."""
        return Gauge(H=self._H, h=tuple((self.widths * self._h).tolist()))
