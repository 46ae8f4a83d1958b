"""What the plant tells the dashboard."""

import time
from bisect import bisect_left
from collections import deque
from math import isfinite
from typing import Final, Self

from plant_service.punctuality import Punctuality, ReachWatch
from plant_service.state import PlantState
from protocol.link.pacing import STATUS_S
from protocol.link.session import CountedTransition
from protocol.link.telemetry import Telemetry
from protocol.messages import LATENCY_BOUNDS_S, Message, PlantModel, PlantStatus
from protocol.messages.management import (
    IncomingFrame,
    PicturedStep,
    PlantSecrets,
    PlantStep,
    TailStep,
    TimingStatus,
)
from protocol.scenario import Calibration, Scenario
from protocol.text import Shown, readable

TAIL: Final = 64
"""Most transitions shown in a status; a whole status has as many."""

TAIL_AT_LEAST: Final = 8
"""Least transitions in a status, so that a dashboard that lost one lacks nothing."""

RATE_S: Final = 0.5
"""Seconds over which the rate of steps is taken."""

MODEL_S: Final = 1.0
"""Seconds between two publications of the plant's model, where statuses come often."""

MODEL_AFTER: Final = 4
"""Statuses from one publication of the model to the next, where statuses come seldom."""


class PlantTelemetry(Telemetry):
    """What a plant's status has beside its state; :meth:`status` puts both together.

    ``late``, ``attack``, ``last_message`` and ``message_k`` (the step at which it came through) are
    set from outside.

    Parameters
    ----------
    model : PlantModel, optional
        What does not change. None: no status is published.
    calibration : Calibration, optional
        What was promised of D_c.
    status_s : float
        Seconds between statuses.
    """

    def __init__(
        self,
        model: PlantModel | None = None,
        calibration: Calibration | None = None,
        status_s: float = STATUS_S,
    ) -> None:
        super().__init__(None if model is None else status_s)
        self.late = 0
        self.last_message = b""
        self.message_k = -1
        self.attack = ""
        self.punctuality = Punctuality()
        self.watch = ReachWatch(calibration)
        self.measured_k, self.measured_at = -1, 0.0
        self._latencies = [0] * (len(LATENCY_BOUNDS_S) + 1)
        self._tail: deque[CountedTransition] = deque(maxlen=0 if model is None else TAIL)
        self.model = model
        self._old = self._new = 0
        self._partial = Shown()
        self._rate_mark = (0.0, 0)
        self._rate_hz = 0.0
        self._published = 0

    @classmethod
    def of(cls, scenario: Scenario, pace: str, *, seeded: bool, status_s: float = STATUS_S) -> Self:
        """For a scenario's plant.

        Parameters
        ----------
        scenario : Scenario
        pace : str
            As the operator gave it.
        seeded : bool
            Whether the run's symbols can be predicted.
        status_s : float
        """
        model = _model(scenario, pace, seeded=seeded)
        return cls(model, scenario.defender.calibration, status_s)

    def measured(self, k: int, now: float) -> None:
        """Note when Measurement(k) left first."""
        if k != self.measured_k:
            self.measured_k, self.measured_at = k, now

    def answered(self, k: int, now: float) -> None:
        """The offer for step ``k`` came: count how long after its measurement."""
        if k == self.measured_k:
            self.took(now - self.measured_at)

    def took(self, seconds: float) -> None:
        """Count an offer that came so long after its measurement."""
        self._latencies[bisect_left(LATENCY_BOUNDS_S, seconds)] += 1

    def counted(self, t: CountedTransition) -> str | None:
        """Take in a transition; a line the first time that the promise of D_c is contradicted."""
        super().counted(t)
        self._tail.append(t)
        self._new += 1
        return self.watch.counted(t.verdict, t.coin)

    def messages(self, state: PlantState, malformed: int) -> tuple[Message, ...]:
        """A status, and once a second the model before it: who hears that lacks nothing."""
        assert self.status_s is not None
        assert self.model is not None
        whole = self._published % max(MODEL_AFTER, round(MODEL_S / self.status_s)) == 0
        self._published += 1
        status = self.status(state, malformed, whole=whole)
        return (self.model, status) if whole else (status,)

    def status(self, state: PlantState, malformed: int, *, whole: bool = True) -> PlantStatus:
        """What the dashboard is told of the plant.

        A ``whole`` one shows all transitions that are remembered, for whoever has not heard the
        statuses before; the others what came since the last but one, should the last be lost.
        """
        link, applied, frame, deframer = (
            state.link,
            state.applied,
            state.frame,
            state.frame.deframer,
        )
        mark, transitions = self._rate_mark
        if state.now - mark >= RATE_S:
            self._rate_hz = max(0.0, (link.transitions - transitions) / (state.now - mark))
            self._rate_mark = (state.now, link.transitions)
        shown = TAIL if whole else max(TAIL_AT_LEAST, self._old + self._new)
        self._old, self._new = self._new, 0
        common = self.common(state, malformed, time.time_ns())
        common["detail"] = self.detail or self.watch.doubt
        return PlantStatus.model_construct(
            **common,
            sessions=state.session.record.sessions,
            step=PlantStep.model_construct(
                **self.step(state),
                missed=applied.missed,
                symbol_errors=applied.symbol_errors,
                outside=self.watch.outside,
            ),
            frame=IncomingFrame.model_construct(
                symbols=len(deframer.symbols),
                length=deframer.expected_length,
                messages=frame.record.messages,
                message_k=self.message_k,
                refused=frame.record.refused,
            ),
            timing=TimingStatus.model_construct(
                late=self.late,
                rate_hz=self._rate_hz,
                latency_counts=tuple(self._latencies),
                sampled_late_s=self.punctuality.sampled_late_s,
                actuated_after_s=self.punctuality.actuated_after_s,
                overruns=self.punctuality.overruns,
            ),
            attack=self.attack,
            secrets=PlantSecrets.model_construct(
                message=self._partial.text(deframer.partial),
                last_message=readable(self.last_message),
                pictured=next(filter(None, map(_pictured, reversed(self._tail))), None),
                tail=tuple(map(_shown, list(self._tail)[-shown:])),
            ),
        )


def _shown(t: CountedTransition) -> TailStep:
    """A transition, with x(k) as both ends have it: as it is read, or the centre of its box."""
    x = t.x if t.verdict.box is None else t.verdict.box.centre
    true = () if t.truth is None else t.truth.x_next
    return TailStep(t.k, x, t.role, t.symbol, t.coin, true)


def _pictured(t: CountedTransition) -> PicturedStep | None:
    """A transition to be drawn; None where it was not tested, or a gauge is no finite number,
    which a message cannot hold."""
    gauges, inside = t.verdict.gauges, t.verdict.inside
    if not (t.tested and all(map(isfinite, gauges))):
        return None
    return PicturedStep.model_construct(k=t.k, gauges=gauges, symbol=t.symbol, inside=inside)


def _model(scenario: Scenario, pace: str, *, seeded: bool) -> PlantModel:
    """What does not change while this process lives."""
    H, h = (scenario.test_set if scenario.plant.C is None else scenario.resisted).rows()
    own = scenario.secrecy.disturbance is not None
    hers = scenario.eavesdropper_set.rows() if own else ((), ())
    return PlantModel(
        scenario=scenario.name,
        law=scenario.control.law,
        pace=pace,
        seeded=seeded,
        period_s=scenario.plant.period_s,
        alpha=scenario.secrecy.alpha,
        defender_H=H,
        defender_h=h,
        A=scenario.A,
        B=scenario.B,
        eavesdropper_H=hers[0],
        eavesdropper_h=hers[1],
        keys_claim="" if scenario.keys is None else scenario.keys.assumption().sentence(),
        keys_eps=0.0 if scenario.keys is None else scenario.keys.eps_sec,
    )
