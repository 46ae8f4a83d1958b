"""What the controller tells the dashboard."""

import time
from typing import Literal, Protocol

from controller_service.laws.online import OnlineLaw
from protocol.link.keying import Keying
from protocol.link.records import SenderRecord
from protocol.messages import ControllerStatus
from protocol.schemes.framing import frame_length
from protocol.text import Shown

Phase = Literal["greeting", "running", "outside", "stopped", "refused"]


class MessageQueue(Protocol):
    """The messages to deliver, in order, numbered from 0, as the journal has them."""

    queued: int
    """How many there ever were."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""


class ControllerTelemetry:
    """What is worth telling beside the record; :meth:`status` puts both together.

    ``phase``, ``detail`` and ``unexplained`` are the core's to set.
    """

    def __init__(self, law: OnlineLaw, *, keys_refused: str = "") -> None:
        self.phase: Phase = "greeting"
        self.detail = ""
        self.unexplained = 0
        self._keys_refused = keys_refused
        self._law = law
        self._sending = Shown()
        self._shown: tuple[int, bytes | None] = -1, None  # a queued message stays what it is
        self._seq = 0

    def status(
        self,
        record: SenderRecord,
        size: int,
        keying: Keying,
        messages: MessageQueue,
        malformed: int,
    ) -> ControllerStatus:
        """What the dashboard is told now; ``size`` is M."""
        idle = record.message >= messages.queued
        shown = min(record.message, messages.queued - 1)
        if shown != self._shown[0]:
            self._shown = shown, messages.payload(shown)
        payload = self._shown[1]
        length = 0 if payload is None else frame_length(len(payload), size)
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
            unexplained=self.unexplained,
            **keying.told(self._keys_refused),
        )
