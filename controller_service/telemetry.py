"""What the controller tells the dashboard."""

import time
from typing import Literal, Protocol

from controller_service.laws.online import OnlineLaw
from protocol.link.sender import Outbox, Sender
from protocol.messages import ControllerStatus
from protocol.scenario import Scenario
from protocol.schemes.framing import frame_length
from protocol.text import readable

Phase = Literal["greeting", "running", "outside", "stopped", "refused"]


class Messages(Outbox, Protocol):
    """The queue of messages as the journal has it, with their identifiers."""

    queued: int

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""


class ControllerTelemetry:
    """What is worth telling beside the record; :meth:`status` puts both together.

    ``phase``, ``detail`` and ``unexplained`` are the endpoint's to set.
    """

    def __init__(
        self, scenario: Scenario, law: OnlineLaw, *, seeded: bool, keys_refused: str = ""
    ) -> None:
        self.phase: Phase = "greeting"
        self.detail = ""
        self.unexplained = 0
        self._scenario = scenario.name
        self._keys_claim = "" if scenario.keys is None else scenario.keys.assumption().sentence()
        self._keys_refused = keys_refused
        self._law = law
        self._seeded = seeded
        self._seq = 0

    def status(self, sender: Sender, messages: Messages, garbage: int) -> ControllerStatus:
        """What the dashboard is told now."""
        record = sender.record
        idle = record.message >= messages.queued
        shown = min(record.message, messages.queued - 1)
        payload = messages.payload(shown) if shown >= 0 else None
        length = 0 if payload is None else frame_length(len(payload), sender.rules.size)
        try:
            set_index = self._law.index(record.x) if record.x else -1
        except LookupError:
            set_index = -1
        self._seq += 1
        return ControllerStatus(
            seq=self._seq,
            t_ns=time.time_ns(),
            phase=self.phase,
            detail=self.detail,
            scenario=self._scenario,
            seeded=self._seeded,
            session=record.session,
            k=record.k,
            set_index=set_index,
            horizon=self._law.design.horizon,
            transitions=record.transitions,
            agreements=record.agreements,
            garbage=garbage,
            automaton=record.s,
            sending="" if payload is None else readable(payload),
            frame_symbols=length if idle else record.offset,
            frame_length=length,
            queue=max(0, messages.queued - record.message - 1),
            delivered=record.message,
            unexplained=self.unexplained,
            **sender.keying.told(self._keys_claim, self._keys_refused),
        )
