"""What the plant's end says of itself, and when: statuses, at times with the model."""

from math import inf
from typing import Final

from plant_service.plant import PlantStep
from plant_service.status import Phase, PlantTelemetry
from protocol.link.events import Timing
from protocol.link.pacing import HEALTH_S, next_turn, phase_of
from protocol.link.peer import Outgoing
from protocol.link.receiver import Receiver
from protocol.messages import PlantModel, PlantStatus, Status
from protocol.text import readable

MODEL_S: Final = 1.0
"""Seconds between two words on the plant's model, where statuses come often."""

MODEL_AFTER: Final = 4
"""Where they come seldom: the model goes before every so manieth status."""


class Telemetry:
    """Statuses in their time, and what they tell beside the record.

    Parameters
    ----------
    news : PlantTelemetry, optional
        Without it nothing is told.
    status_s : float
        Seconds between statuses.
    now : float
        The time; the first status is due.
    instance : str
        Which plant of many this is: they do not all tell at once.

    Attributes
    ----------
    at : float
        When the next status is due.
    """

    def __init__(
        self, news: PlantTelemetry | None, status_s: float, now: float, instance: str
    ) -> None:
        self.news = news
        self.at = inf if news is None else now
        self._status_s, self._phase = status_s, phase_of(instance)
        self._model_every = max(MODEL_AFTER, round(MODEL_S / status_s))
        self._said = 0
        self._health_at = -inf

    def phase(self, phase: Phase, detail: str = "") -> None:
        """How it stands with the link."""
        if self.news is not None:
            self.news.phase = phase
            self.news.detail = detail or self.news.detail

    def stopped(self) -> None:
        """It is over, if it was not refused."""
        if self.news is not None and self.news.phase != "refused":
            self.news.phase = "stopped"

    def answered(self, seconds: float) -> None:
        """An offer came so long after its measurement."""
        if self.news is not None:
            self.news.answered(seconds)

    def answered_late(self) -> None:
        """An offer came after its step."""
        if self.news is not None:
            self.news.late += 1

    def acted(self, after_s: float) -> None:
        """An input was applied so long after its tick."""
        if self.news is not None:
            self.news.punctuality.acted(after_s)

    def ticked(self, late_s: float, overruns: int) -> None:
        """A tick was noticed so late."""
        if self.news is not None:
            self.news.punctuality.ticked(late_s, overruns)

    def counted(self, step: PlantStep) -> str | None:
        """A step was counted; a line the first time that the promise of D_c is contradicted."""
        return None if self.news is None else self.news.counted(step)

    def recovered(self, payload: bytes, k: int) -> None:
        """A message came through at step ``k``."""
        if self.news is not None:
            self.news.last_message = readable(payload)
            self.news.message_k = k

    def timing(self, k: int) -> tuple[Timing, ...]:
        """For the trace, at the end: how punctual the steps were."""
        event = None if self.news is None else self.news.punctuality.as_event(k)
        return () if event is None else (event,)

    def due(
        self, receiver: Receiver, malformed: int, now: float
    ) -> tuple[tuple[Outgoing, ...], Status | None]:
        """As :meth:`status`, if its time has come."""
        if now < self.at:
            return (), None
        self.at = next_turn(now, self._status_s, self._phase)
        return self.status(receiver, malformed, now, force=False)

    def status(
        self, receiver: Receiver, malformed: int, now: float, *, force: bool
    ) -> tuple[tuple[Outgoing, ...], Status | None]:
        """A status to publish, at times with the model, and once in :data:`HEALTH_S` to be kept.

        One that is ``force``\\ d is kept in any case.
        """
        if self.news is None:
            return (), None
        whole = self._said % self._model_every == 0
        self._said += 1
        status = self.news.status(receiver, malformed, now, whole=whole)
        publish: tuple[Outgoing, ...] = (Outgoing(PlantStatus, status.wire()),)
        if whole:  # who hears this one lacks nothing
            publish = (Outgoing(PlantModel, self.news.model), *publish)
        keep = force or now >= self._health_at
        if keep:
            self._health_at = now + HEALTH_S
        return publish, status if keep else None
