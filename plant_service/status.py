"""What the plant tells the dashboard."""

import time
from bisect import bisect_left
from collections import deque
from math import isfinite
from typing import Final, Literal

from plant_service.plant import PlantStep
from plant_service.punctuality import Punctuality, ReachWatch
from protocol.link.receiver import Receiver
from protocol.link.session import CountedTransition
from protocol.messages import LATENCY_BOUNDS_S, PlantModel, PlantStatus
from protocol.scenario import Scenario
from protocol.text import Shown

TAIL: Final = 64
"""Transitions shown in a whole status, and at most in any."""

TAIL_AT_LEAST: Final = 8
"""In any status: a dashboard that lost some lacks nothing."""

RATE_S: Final = 0.5
"""Seconds over which the rate of steps is taken."""

Phase = Literal["greeting", "running", "stopped", "refused"]


class PlantTelemetry:
    """What is worth telling beside the record; :meth:`status` puts both together.

    ``phase``, ``detail``, ``late``, ``last_message`` and ``message_k`` are set by the service;
    ``model`` is what does not change, as it travels.
    """

    def __init__(self, scenario: Scenario, pace: str, *, seeded: bool) -> None:
        self.phase: Phase = "greeting"
        self.detail = ""
        self.late = 0
        self.last_message = ""
        self.message_k = -1
        self._latencies = [0] * (len(LATENCY_BOUNDS_S) + 1)
        self._tail: deque[tuple[CountedTransition, int]] = deque(maxlen=TAIL)
        self.punctuality = Punctuality()
        self.watch = ReachWatch(scenario.defender.calibration)
        self.keys_refused = ""
        self.model = _model(scenario, pace, seeded=seeded).wire()
        self._old = self._new = 0
        self._partial = Shown()
        self._seq = 0
        self._rate_mark = (0.0, 0)
        self._rate_hz = 0.0

    def answered(self, seconds: float) -> None:
        """Count an offer that came so long after its measurement."""
        self._latencies[bisect_left(LATENCY_BOUNDS_S, seconds)] += 1

    def counted(self, step: PlantStep) -> str | None:
        """Take in a counted step; a line the first time that the promise of D_c is contradicted."""
        assert step.effects is not None
        assert step.coin is not None
        self._tail.append((step.effects.transition, step.coin))
        self._new += 1
        return self.watch.counted(step.effects.transition, step.coin)

    def status(
        self, receiver: Receiver, malformed: int, now_s: float, *, whole: bool = True
    ) -> PlantStatus:
        """What the dashboard is told at monotonic time ``now_s``.

        A ``whole`` one shows all transitions that are remembered, for whoever has not heard the
        statuses before; the others what came since the last but one, should the last be lost.
        """
        record = receiver.record
        mark, transitions = self._rate_mark
        if now_s - mark >= RATE_S:
            self._rate_hz = max(0.0, (record.transitions - transitions) / (now_s - mark))
            self._rate_mark = (now_s, record.transitions)
        self._seq += 1
        shown = TAIL if whole else max(TAIL_AT_LEAST, self._old + self._new)
        self._old, self._new = self._new, 0
        steps = list(self._tail)[-shown:]
        tail = [t for t, _ in steps]
        pictured = next((t for t, _ in reversed(self._tail) if _can_be_drawn(t)), None)
        return PlantStatus.model_construct(
            seq=self._seq,
            t_ns=time.time_ns(),
            phase=self.phase,
            detail=self.detail or self.watch.doubt,
            session=record.session,
            sessions=record.sessions,
            k=record.k,
            x=record.x,
            transitions=record.transitions,
            missed=record.missed,
            late=self.late,
            malformed=malformed,
            agreements=record.agreements,
            symbol_errors=record.symbol_errors,
            rate_hz=self._rate_hz,
            automaton=record.s,
            recovered_symbols=record.p,
            messages=record.messages,
            last_message=self.last_message,
            message_k=self.message_k,
            latency_counts=tuple(self._latencies),
            partial=self._partial.text(receiver.deframer.partial),
            frame_symbols=len(receiver.deframer.symbols),
            frame_length=receiver.deframer.expected_length,
            frames_refused=record.frames_refused,
            outside=self.watch.outside,
            unexplained=self.watch.unexplained,
            sampled_late_s=self.punctuality.sampled_late_s,
            actuated_after_s=self.punctuality.actuated_after_s,
            overruns=self.punctuality.overruns,
            **receiver.keying.told(self.keys_refused),
            key_blocks_begun=record.blocks_begun,
            pictured_k=pictured.k if pictured else -1,
            pictured_x=pictured.x if pictured else (),
            pictured_candidates=pictured.candidates if pictured else (),
            pictured_x_next=pictured.x_next if pictured else (),
            pictured_gauges=pictured.verdict.gauges if pictured else (),
            pictured_symbol=pictured.symbol if pictured else -1,
            pictured_inside=pictured.verdict.inside if pictured else 0,
            tail_k=tuple([t.k for t in tail]),
            tail_x=tuple([t.x for t in tail]),
            tail_role=tuple([t.role for t in tail]),
            tail_symbol=tuple([t.symbol for t in tail]),
            tail_automaton=tuple([t.s for t in tail]),
            tail_coin=tuple([coin for _, coin in steps]),
        )


def _model(scenario: Scenario, pace: str, *, seeded: bool) -> PlantModel:
    """What does not change while this process lives."""
    H, h = scenario.defender.disturbance.rows()
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
    )


def _can_be_drawn(t: CountedTransition) -> bool:
    """A message holds finite numbers only; gauges of huge states are not."""
    return t.tested and all(map(isfinite, t.verdict.gauges))
