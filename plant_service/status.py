"""What the plant tells the dashboard."""

import time
from bisect import bisect_left
from collections import deque
from math import isfinite
from typing import Final, Literal

from plant_service.plant import Step
from plant_service.punctuality import Punctuality, ReachWatch
from protocol.link.receiver import Receiver
from protocol.link.session import CountedTransition
from protocol.messages import LATENCY_BOUNDS_S, PlantStatus
from protocol.scenario import Scenario
from protocol.text import readable

TAIL: Final = 64
"""Transitions shown in a status."""

RATE_S: Final = 0.5
"""Seconds over which the rate of steps is taken."""

Phase = Literal["greeting", "running", "stopped", "refused"]


class PlantTelemetry:
    """What is worth telling beside the record; :meth:`status` puts both together.

    ``phase``, ``detail``, ``late``, ``last_message``, ``message_k`` and ``tail`` are set by the
    service.
    """

    def __init__(self, scenario: Scenario, pace: str, *, seeded: bool) -> None:
        self.phase: Phase = "greeting"
        self.detail = ""
        self.late = 0
        self.last_message = ""
        self.message_k = -1
        self._latencies = [0] * (len(LATENCY_BOUNDS_S) + 1)
        self.tail: deque[Step] = deque(maxlen=TAIL)
        self.punctuality = Punctuality()
        self.watch = ReachWatch(scenario.defender.calibration)
        self.keys_claim = "" if scenario.keys is None else scenario.keys.assumption().sentence()
        self.keys_refused = ""
        self._scenario = scenario
        self._pace = pace
        self._seeded = seeded
        self._seq = 0
        self._rate_mark = (0.0, 0)
        self._rate_hz = 0.0

    def answered(self, seconds: float) -> None:
        """Count an offer that came so long after its measurement."""
        self._latencies[bisect_left(LATENCY_BOUNDS_S, seconds)] += 1

    def status(self, receiver: Receiver, garbage: int, now_s: float) -> PlantStatus:
        """What the dashboard is told at monotonic time ``now_s``."""
        scenario = self._scenario
        record = receiver.record
        mark, transitions = self._rate_mark
        if now_s - mark >= RATE_S:
            self._rate_hz = max(0.0, (record.transitions - transitions) / (now_s - mark))
            self._rate_mark = (now_s, record.transitions)
        self._seq += 1
        H, h = scenario.defender.disturbance.rows()
        tail = [step.effects.transition for step in self.tail if step.effects is not None]
        pictured = next((t for t in reversed(tail) if _can_be_drawn(t)), None)
        return PlantStatus(
            seq=self._seq,
            t_ns=time.time_ns(),
            phase=self.phase,
            detail=self.detail or self.watch.doubt,
            scenario=scenario.name,
            law=scenario.control.law,
            pace=self._pace,
            seeded=self._seeded,
            period_s=scenario.plant.period_s,
            alpha=scenario.secrecy.alpha,
            defender_H=H,
            defender_h=h,
            A=scenario.A,
            B=scenario.B,
            session=record.session,
            sessions=record.sessions,
            k=record.k,
            x=record.x,
            transitions=record.transitions,
            missed=record.missed,
            late=self.late,
            garbage=garbage,
            agreements=record.agreements,
            symbol_errors=record.symbol_errors,
            rate_hz=self._rate_hz,
            automaton=record.s,
            recovered_symbols=record.p,
            messages=record.messages,
            last_message=self.last_message,
            message_k=self.message_k,
            latency_counts=tuple(self._latencies),
            partial=readable(receiver.deframer.partial),
            frame_symbols=len(receiver.deframer.symbols),
            frame_length=receiver.deframer.expected_length,
            frames_refused=record.frames_refused,
            outside=self.watch.outside,
            unexplained=self.watch.unexplained,
            sampled_late_s=self.punctuality.sampled_late_s,
            actuated_after_s=self.punctuality.actuated_after_s,
            overruns=self.punctuality.overruns,
            **receiver.keying.told(self.keys_claim, self.keys_refused),
            pictured_k=pictured.k if pictured else -1,
            pictured_x=pictured.x if pictured else (),
            pictured_candidates=pictured.candidates if pictured else (),
            pictured_x_next=pictured.x_next if pictured else (),
            pictured_gauges=pictured.verdict.gauges if pictured else (),
            pictured_symbol=pictured.symbol if pictured else -1,
            pictured_inside=pictured.verdict.inside if pictured else 0,
            tail_k=tuple(t.k for t in tail),
            tail_x=tuple(t.x for t in tail),
            tail_role=tuple(t.role for t in tail),
            tail_symbol=tuple(t.symbol for t in tail),
            tail_automaton=tuple(t.s for t in tail),
            tail_coin=tuple(step.coin for step in self.tail if step.coin is not None),
        )


def _can_be_drawn(t: CountedTransition) -> bool:
    """A message holds finite numbers only; gauges of huge states are not."""
    return t.tested and all(map(isfinite, t.verdict.gauges))
