"""What the controller tells the dashboard."""

import time
from typing import Any, Final, Literal, Protocol

from controller_service.laws.online import OnlineLaw
from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import Distiller
from protocol.link.events import Alarm
from protocol.link.records import SenderRecord
from protocol.link.session import CountedTransition, Rules
from protocol.messages import ControllerStatus
from protocol.schemes.framing import frame_length
from protocol.text import Shown

Phase = Literal["greeting", "running", "outside", "alarmed", "stopped", "refused"]


LARGEST_GAUGE: Final = 1e300
"""What a status says of one that is larger still: a message holds finite numbers only."""


class MessageQueue(Protocol):
    """The messages to deliver, in order, numbered from 0, as the journal has them."""

    queued: int
    """How many there ever were."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``; None while it is not queued, and once it was delivered."""

    def crc_of(self, identifier: str) -> int | None:
        """The CRC-32 of the message that was queued under this identifier, or None."""

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""


class ControllerTelemetry:
    """What is worth telling beside the record; :meth:`status` puts both together.

    ``phase`` and ``detail`` are the core's to set.
    """

    def __init__(self, law: OnlineLaw) -> None:
        self.phase: Phase = "greeting"
        self.detail = ""
        self._unexplained = self._watched = self._unwatched = self._alarms = 0
        self._alarm: Alarm | None = None
        self._law = law
        self._sending = Shown()
        self._shown: tuple[int, bytes | None] = -1, None  # a queued message stays what it is
        self._delivered: bytes | None = None
        self._seq = 0

    def counted(self, t: CountedTransition) -> None:
        """Take in a transition."""
        self._unexplained += t.verdict.unexplained
        if t.expected != NO_SYMBOL:
            self._watched += 1
        else:
            self._unwatched += 1
        if t.delivered is not None:
            self._delivered = t.delivered.payload

    def alarmed(self, alarm: Alarm) -> None:
        """Take in an alarm."""
        self._alarms += 1
        self._alarm = alarm

    def status(
        self,
        record: SenderRecord,
        rules: Rules,
        keys: Distiller,
        messages: MessageQueue,
        malformed: int,
    ) -> ControllerStatus:
        """What the dashboard is told now."""
        idle, shown = record.message >= messages.queued, record.message
        if not idle and shown != self._shown[0]:
            self._shown = shown, messages.payload(shown)
        payload = self._delivered if idle else self._shown[1]
        length = 0 if payload is None else frame_length(len(payload), rules.size)
        try:
            set_index = self._law.index(record.x) if record.x else -1
        except LookupError:
            set_index = -1
        self._seq += 1
        return ControllerStatus.model_construct(
            seq=self._seq,
            t_ns=time.time_ns(),
            phase=self.phase,
            detail=self.detail,
            session=record.session,
            k=record.k,
            set_index=set_index,
            transitions=record.transitions,
            agreements=record.agreements,
            malformed=malformed,
            automaton=record.s,
            sending="" if payload is None else self._sending.text(payload),
            frame_symbols=length if idle else record.offset,
            frame_length=length,
            queue=max(0, messages.queued - record.message - 1),
            delivered=record.message,
            unexplained=self._unexplained,
            watched=self._watched,
            unwatched=self._unwatched if rules.keyed else 0,
            alarms=self._alarms,
            **self._last_alarm(),
            **keys.status_fields(),
        )

    def _last_alarm(self) -> dict[str, Any]:
        """A status's fields of the last alarm."""
        alarm = self._alarm
        if alarm is None:
            return {}
        return {
            "alarm_k": alarm.k,
            "alarm_reading": alarm.reading,
            "alarm_expected": () if alarm.reason == "unwatched" else alarm.expected,
            "alarm_gauge": min(alarm.gauge, LARGEST_GAUGE),
        }
