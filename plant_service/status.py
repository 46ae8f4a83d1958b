"""What the plant tells the dashboard."""

import time
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from math import isfinite
from typing import Final, Self

from plant_service.punctuality import Punctuality, ReachWatch
from plant_service.state import PlantState
from protocol.link.pacing import STATUS_S
from protocol.link.records import LinkRecord
from protocol.link.session import CountedTransition
from protocol.link.telemetry import Telemetry
from protocol.messages import LATENCY_BOUNDS_S, Message, PlantModel, PlantStatus
from protocol.scenario import Calibration, Scenario
from protocol.text import Shown, readable
from protocol.vectors import Vector

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
    hidden : int
        Where outputs are read: states, which are told once they are estimated.
    status_s : float
        Seconds between statuses.
    """

    def __init__(
        self,
        model: PlantModel | None = None,
        calibration: Calibration | None = None,
        hidden: int = 0,
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
        self._hidden = hidden
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
        hidden = 0 if scenario.plant.C is None else scenario.n
        model = _model(scenario, pace, seeded=seeded)
        return cls(model, scenario.defender.calibration, hidden, status_s)

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

    def _x(self, link: LinkRecord) -> Vector:
        """x(k) as it is read; where outputs are read, as it was estimated after the last offer."""
        if link.estimate is not None:
            return link.estimate.box.centre
        return (0.0,) * self._hidden or link.x

    def status(self, state: PlantState, malformed: int, *, whole: bool = True) -> PlantStatus:
        """What the dashboard is told of the plant.

        A ``whole`` one shows all transitions that are remembered, for whoever has not heard the
        statuses before; the others what came since the last but one, should the last be lost.
        """
        session, link, applied, frame, _ = state.record
        deframer, now_s = state.frame.deframer, state.now
        mark, transitions = self._rate_mark
        if now_s - mark >= RATE_S:
            self._rate_hz = max(0.0, (link.transitions - transitions) / (now_s - mark))
            self._rate_mark = (now_s, link.transitions)
        self._seq += 1
        shown = TAIL if whole else max(TAIL_AT_LEAST, self._old + self._new)
        self._old, self._new = self._new, 0
        tail = list(self._tail)[-shown:]
        pictured = next(filter(_can_be_drawn, reversed(self._tail)), None)
        true = _truths(tail)
        return PlantStatus.model_construct(
            seq=self._seq,
            t_ns=time.time_ns(),
            phase=self.phase,
            detail=self.detail or self.watch.doubt,
            session=session.id,
            sessions=session.sessions,
            k=link.k,
            x=self._x(link),
            transitions=link.transitions,
            missed=applied.missed,
            late=self.late,
            malformed=malformed,
            agreements=link.agreements,
            symbol_errors=applied.symbol_errors,
            rate_hz=self._rate_hz,
            automaton=link.s,
            recovered_symbols=link.p,
            messages=frame.messages,
            last_message=readable(self.last_message),
            message_k=self.message_k,
            latency_counts=tuple(self._latencies),
            partial=self._partial.text(deframer.partial),
            frame_symbols=len(deframer.symbols),
            frame_length=deframer.expected_length,
            frames_refused=frame.refused,
            outside=self.watch.outside,
            unexplained=self.watch.unexplained,
            sampled_late_s=self.punctuality.sampled_late_s,
            actuated_after_s=self.punctuality.actuated_after_s,
            overruns=self.punctuality.overruns,
            **state.keys.status_fields(),
            key_blocks_begun=state.keys.record.begun,
            pictured_k=pictured.k if pictured else -1,
            pictured_x=_before(pictured) if pictured else (),
            pictured_candidates=pictured.candidates if pictured else (),
            pictured_x_next=_after(pictured) if pictured else (),
            pictured_gauges=pictured.verdict.gauges if pictured else (),
            pictured_symbol=pictured.symbol if pictured else -1,
            pictured_inside=pictured.verdict.inside if pictured else 0,
            tail_k=tuple([t.k for t in tail]),
            tail_x=tuple([_before(t) for t in tail]),
            tail_role=tuple([t.role for t in tail]),
            tail_symbol=tuple([t.symbol for t in tail]),
            tail_automaton=tuple([t.s for t in tail]),
            tail_coin=tuple([t.coin for t in tail]),
            attack=self.attack,
            true_x=true[-1] if true and tail[-1].k + 1 == link.k else (),
            tail_true_x=true,
        )


def _before(t: CountedTransition) -> Vector:
    """x(k) as both ends have it: as it is read, or the centre of its box."""
    return t.x if t.verdict.box is None else t.verdict.box.centre


def _after(t: CountedTransition) -> Vector:
    """x(k+1) likewise."""
    return t.x_next if t.verdict.estimate is None else t.verdict.estimate.box.centre


def _truths(tail: Sequence[CountedTransition]) -> tuple[Vector, ...]:
    """The true states of an attacked plant after these, where all of them are known."""
    true = tuple(t.truth.x_next for t in tail if t.truth is not None)
    return true if len(true) == len(tail) else ()


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


def _can_be_drawn(t: CountedTransition) -> bool:
    """Whether its gauges are finite: a message holds no other numbers."""
    return t.tested and all(map(isfinite, t.verdict.gauges))
