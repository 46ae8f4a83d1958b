"""What the controller tells the dashboard."""

import time
from typing import Final

from controller_service.laws.base import CandidateLaw
from controller_service.state import ControllerState
from protocol.agreement import NO_SYMBOL
from protocol.link.events import Alarm
from protocol.link.pacing import STATUS_S
from protocol.link.session import CountedTransition
from protocol.link.telemetry import Telemetry
from protocol.messages import ControllerStatus
from protocol.messages.management import AlarmStatus, EndSecrets, OutgoingFrame, StepStatus
from protocol.schemes.framing import frame_length
from protocol.text import Shown

LARGEST_GAUGE: Final = 1e300
"""What a status says of one that is larger still: a message holds finite numbers only."""


class ControllerTelemetry(Telemetry):
    """What a controller's status has beside its state; :meth:`status` puts both together.

    Parameters
    ----------
    law : CandidateLaw, optional
        None: no status is published.
    status_s : float
        Seconds between statuses.
    """

    def __init__(self, law: CandidateLaw | None = None, status_s: float = STATUS_S) -> None:
        super().__init__(None if law is None else status_s)
        self._watched = self._unwatched = 0
        self._alarms = AlarmStatus()
        self._law = law
        self._sending = Shown()
        self._shown: tuple[int, bytes | None] = -1, None  # a queued message stays what it is
        self._delivered: bytes | None = None

    def counted(self, t: CountedTransition) -> None:
        """Take in a transition."""
        super().counted(t)
        if t.expected != NO_SYMBOL:
            self._watched += 1
        else:
            self._unwatched += 1
        if t.delivered is not None:
            self._delivered = t.delivered.payload

    def alarmed(self, alarm: Alarm) -> None:
        """Take in an alarm."""
        self._alarms = self._alarms.model_copy(
            update={
                "count": self._alarms.count + 1,
                "k": alarm.k,
                "reading": alarm.reading,
                "expected": () if alarm.reason == "unwatched" else alarm.expected,
                "gauge": min(alarm.gauge, LARGEST_GAUGE),
            }
        )

    def status(self, state: ControllerState, malformed: int) -> ControllerStatus:
        """What the dashboard is told of the controller."""
        link, frame, messages, rules = state.link, state.frame.record, state.messages, state.rules
        idle, shown = frame.message >= messages.queued, frame.message
        if not idle and shown != self._shown[0]:
            self._shown = shown, messages.payload(shown)
        payload = self._delivered if idle else self._shown[1]
        length = 0 if payload is None else frame_length(len(payload), rules.size)
        try:
            set_index = self._law.index(link.x) if self._law is not None and link.x else -1
        except LookupError:
            set_index = -1
        unwatched = self._unwatched if rules.keyed else 0
        return ControllerStatus.model_construct(
            **self.common(state, malformed, time.time_ns()),
            set_index=set_index,
            step=StepStatus.model_construct(**self.step(state)),
            frame=OutgoingFrame.model_construct(
                symbols=length if idle else frame.offset,
                length=length,
                delivered=frame.message,
                queue=max(0, messages.queued - frame.message - 1),
            ),
            alarms=self._alarms.model_copy(
                update={"watched": self._watched, "unwatched": unwatched}
            ),
            secrets=EndSecrets.model_construct(
                message="" if payload is None else self._sending.text(payload)
            ),
        )
