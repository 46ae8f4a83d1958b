"""Transitions where outputs alone are read: held until the readings show what was applied."""

from collections import deque
from typing import NamedTuple

from tap_service.capture.transcript import Transition
from tap_service.inference.output_model import LATER, LOST, OutputModel


class Known(NamedTuple):
    """A transition, the candidate applied (None: not heard), and its place in its session.

    ``place`` is -1 where the session's beginning was not heard.
    """

    transition: Transition
    symbol: int | None
    place: int

    @property
    def doubtful(self) -> bool:
        """Whether the two ends may have lost it."""
        return 0 <= self.place < LOST

    def row(self, size: int) -> list[float]:
        """Gauges of M candidates that say as much."""
        return [0.0 if i == self.symbol else 1.0 for i in range(size)]


class Opening:
    """Takes transitions, and gives them out once she knows what was applied.

    Parameters
    ----------
    model : OutputModel
    """

    lost = range(1, LOST + 1)
    """Numbers of first steps that the two ends may have lost."""

    def __init__(self, model: OutputModel) -> None:
        self._model = model
        self._held: deque[Transition] = deque()
        self._place = -1

    def take(self, t: Transition) -> tuple[list[Known], list[float] | None]:
        """The transitions that are known by this one, in order; and its gauges at first sight."""
        given: list[Known] = []
        if t.start or t.gap:
            given = self.flush()
            self._place = 0 if t.start else -1
        if t.x is None or t.candidates is None or t.x_next is None:
            return [*given, *self.flush(), self._known(t, None)], None
        if self._held and self._held[-1].x_next != t.x:
            given += self.flush()
        gauges = self._model.gauges(t.x, t.candidates, t.x_next)
        self._held.append(t)
        if len(self._held) > LATER:
            given.append(self._known(self._held.popleft(), self._model.applied[0]))
        return given, gauges

    def flush(self) -> list[Known]:
        """What is held, with what she knows by now."""
        held = list(self._held)
        self._held.clear()
        applied = self._model.applied[-len(held) :] if held else []
        return [self._known(t, symbol) for t, symbol in zip(held, applied, strict=True)]

    def _known(self, t: Transition, symbol: int | None) -> Known:
        place = self._place
        if place >= 0:
            self._place += 1
        return Known(t, symbol, place)
