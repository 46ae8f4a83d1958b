"""The controller's shell: buses, journal and trace around :class:`protocol.link.sender.Sender`."""

import base64
import queue
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from pydantic import ValidationError

from controller_service.laws.paper import ControlLaw
from protocol.link.sender import Sender, SenderEffects
from protocol.link.session import SILENCE_S, rules_of
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Offer,
    PlantHello,
    SendCommand,
    SendReply,
)
from protocol.runtime.inbox import Inbox
from protocol.runtime.journal import ControllerJournal, JournalError
from protocol.runtime.process import (
    DONE,
    USAGE,
    Complaints,
    Throttle,
    UsageError,
    give_way,
    logger,
    new_id,
    spoken,
)
from protocol.runtime.run_folder import (
    CONTROLLER_JOURNAL,
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
    write_atomically,
)
from protocol.runtime.trace import TraceWriter
from protocol.runtime.zenoh_bus import Bus
from protocol.scenario import Scenario
from protocol.schemes.framing import MAX_PAYLOAD, frame_length, readable
from protocol.streams import CIPHER, symbols
from protocol.topics import key_of

GREETING_S: Final = 0.1
"""Seconds between greetings while the plant speaks of a session that is not this process's."""

SILENT_PERIODS: Final = 3
"""A plant counts as away after so many of its periods at least, however long they are."""

INITIAL_ID: Final = "initial"
"""Identifier of the message that a controller is started with; no command may take it."""

LOOK_S: Final = 0.1
"""Longest wait before the loop looks at its signals again."""

STATUS_S: Final = 0.05
HEALTH_S: Final = 1.0


Phase = Literal["greeting", "running", "outside", "stopped", "refused"]


@dataclass(frozen=True, slots=True)
class ControllerConfig:
    """What the controller service is started with.

    ``message`` is queued once in a journal's life, however often the service is started with it;
    ``seed`` is for experiments only.
    """

    scenario: Scenario
    law: ControlLaw
    run_dir: Path
    loop: str
    message: bytes | None = None
    seed: int | None = None


class ControllerService:
    """Answers measurements with offers until it is told to stop.

    Parameters
    ----------
    config : ControllerConfig
    field, ops : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    """

    def __init__(
        self, config: ControllerConfig, field: Bus, ops: Bus, stopping: threading.Event
    ) -> None:
        scenario = config.scenario
        self._config = config
        self._stopping = stopping
        self._log = logger("controller")
        self._garbage = Complaints(self._log)
        self._refusals = Complaints(self._log)
        try:
            self._journal = ControllerJournal(
                config.run_dir / CONTROLLER_JOURNAL, scenario.fingerprint()
            )
            record = self._journal.load()
            step = self._journal.step()
        except JournalError as error:
            raise UsageError(str(error)) from None
        self._trace = TraceWriter(
            config.run_dir / CONTROLLER_TRACE, "controller", scenario.identity()
        )
        self.sender = Sender(
            rules_of(scenario),
            config.law.candidates,
            self._journal,
            symbols(config.seed, CIPHER),
            new_id(),
            record,
            step,
        )
        self._phase: Phase = "greeting"
        self._detail = ""
        self._seq = 0
        self._status_due = Throttle(STATUS_S)
        self._health_due = Throttle(HEALTH_S)
        self._greeting_due = Throttle(GREETING_S)
        self._plant_at = float("-inf")
        self._running_s = max(SILENCE_S, SILENT_PERIODS * scenario.plant.period_s)
        self._queue: Inbox[tuple[str, bytes]] = Inbox()
        loop = config.loop
        self._measurement_key = key_of(Measurement, loop)
        self._hello_key = key_of(PlantHello, loop)
        self._send_key = key_of(SendCommand, loop)
        self._offer = field.publisher(key_of(Offer, loop))
        self._hello = ops.publisher(key_of(ControllerHello, loop))
        self._reply = ops.publisher(key_of(SendReply, loop))
        self._status = ops.publisher(key_of(ControllerStatus, loop))
        if self.sender.unsettled:
            self._settle()
        if config.message is not None:
            self._enqueue(INITIAL_ID, config.message)
        field.subscribe(self._measurement_key, self._arrived)
        ops.subscribe(self._hello_key, self._arrived)
        ops.subscribe(self._send_key, self._arrived)
        if config.seed is not None:
            self._log.warning("seed %d: symbols are predictable, for experiments only", config.seed)
        self._log.info(
            "session %s, model %s, %d messages queued, %d delivered",
            self.sender.record.session or "none yet",
            spoken(scenario.fingerprint()),
            self._journal.queued,
            self.sender.record.message,
        )

    def _arrived(self, key: str, payload: bytes, _t_ns: int) -> None:
        self._queue.put((key, payload))

    # --- the loop ---------------------------------------------------------------------------------

    def run(self) -> int:
        """Answer until stopped; returns the exit code."""
        try:
            self._greet()
            while not self._stopping.is_set():
                if self._phase == "refused":
                    return USAGE
                now = time.monotonic()
                if self._status_due.ready(now):
                    self._publish_status()
                try:
                    key, payload = self._queue.get(timeout=LOOK_S)
                except queue.Empty:
                    continue
                if key == self._measurement_key:
                    self._measured(payload)
                elif key == self._hello_key:
                    self._heard(payload)
                else:
                    self._commanded(payload)
            self._phase = "stopped"
            return DONE
        finally:
            self._close()

    def _close(self) -> None:
        try:
            self._publish_status(force=True)
        except OSError as error:
            self._log.warning("the last status is lost: %s", error)
        finally:
            self._trace.close()
            self._journal.close()

    # --- events -----------------------------------------------------------------------------------

    def _measured(self, payload: bytes) -> None:
        try:
            measurement = Measurement.model_validate_json(payload)
            effects = self.sender.measured(measurement)
        except ValidationError as error:
            self._garbage.add(f"measurement: {error.error_count()} fields not as expected; ignored")
            return
        except ValueError as error:
            self._garbage.add(f"{error}; ignored")
            return
        if self.sender.plant is not None and measurement.session == self.sender.record.session:
            self._plant_at = time.monotonic()
        if effects.append:
            self._answer(payload, effects)
        else:
            self._carry_out(effects)
        if effects.offer is not None:
            self._phase, self._detail = "running", ""
        elif effects.refusal:
            self._phase = "outside" if self.sender.record.session else "greeting"

    def _heard(self, payload: bytes) -> None:
        """The plant spoke on ops."""
        try:
            hello = PlantHello.model_validate_json(payload)
        except ValidationError as error:
            self._garbage.add(f"hello: {error.error_count()} fields not as expected; ignored")
            return
        before = (self.sender.plant, self.sender.record.session)
        running = time.monotonic() - self._plant_at < self._running_s
        effects = self.sender.heard_plant(hello, running=running)
        if effects.save:
            self._trace.write(
                {
                    "event": "session",
                    "session": self.sender.record.session,
                    "reason": effects.refusal or "the plant began it",
                }
            )
        self._carry_out(effects)
        if self.sender.refused:
            self._phase = "refused"
            self._detail = (
                f"the plant's model is {spoken(hello.fingerprint)}, "
                f"this controller's is {spoken(self.sender.rules.fingerprint)}"
            )
            self._log.error("%s: the two ends must share one scenario", self._detail)
        elif self.sender.plant is None:
            self._phase = "greeting"
        elif before != (self.sender.plant, self.sender.record.session):
            self._phase, self._detail = "running", ""
            self._log.info("session %s taken up with plant %s", hello.session, hello.instance)

    def _answer(self, measurement: bytes, effects: SenderEffects) -> None:
        """Save the step and publish the offer; the plant works on it while the rest is done."""
        assert effects.offer is not None
        offer = effects.offer.wire()
        self._journal.append(measurement, offer)
        self._offer.put(offer)
        give_way()
        self._settle()

    def _settle(self) -> None:
        effects = self.sender.settle()
        if not effects.save:
            self._journal.stage(self.sender.record)
        self._carry_out(effects)

    def _carry_out(self, effects: SenderEffects) -> None:
        """Trace, save, publish: in this order, so that nothing is sent that is not saved."""
        if effects.transition is not None:
            self._trace.write(effects.transition.as_event())
        if effects.save:
            self._journal.save(self.sender.record)
        if effects.offer is not None:
            self._offer.put(effects.offer.wire())
        if effects.reply is not None:
            self._hello.put(effects.reply.wire())
        if effects.greet and self._greeting_due.ready(time.monotonic()):
            self._greet()
        if effects.refusal:
            self._detail = effects.refusal
            self._refusals.add(effects.refusal)
        if effects.delivered is not None:
            self._delivered(effects.delivered)

    def _delivered(self, number: int) -> None:
        payload = self._journal.payload(number)
        assert payload is not None
        self._trace.write(
            {
                "event": "delivered",
                "id": self._journal.identifier(number),
                "payload": base64.b64encode(payload).decode(),
            }
        )
        self._log.info("message %s delivered", self._journal.identifier(number))
        self._publish_status(force=True)

    def _commanded(self, payload: bytes) -> None:
        """The operator hands over a message; the same identifier is queued once."""
        try:
            command = SendCommand.model_validate_json(payload)
        except ValidationError as error:
            self._garbage.add(f"command: {error.error_count()} fields not as expected; ignored")
            return
        size, queued = len(command.payload), self._journal.queued_as(command.id)
        accepted, detail = False, ""
        if command.id == INITIAL_ID:
            detail = f"id: {INITIAL_ID!r} is the message that the controller is started with"
        elif size > MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected at most {MAX_PAYLOAD}"
        elif queued is None:
            self._enqueue(command.id, command.payload)
            accepted = True
        elif queued == command.payload:
            accepted, detail = True, "already queued"
        else:
            detail = f"id: {command.id!r} is another message's"
        reply = SendReply(
            id=command.id,
            accepted=accepted,
            queued=self._journal.queued - self.sender.record.message,
            detail=detail,
        )
        self._reply.put(reply.wire())

    def _enqueue(self, identifier: str, payload: bytes) -> None:
        if self._journal.queued_as(identifier) is None:
            # The step under way was decided without it: should it be counted again, then so too.
            self._journal.save(self.sender.record)
            # traced first: what is queued in the journal must not be missing from the trace
            self._trace.write(
                {
                    "event": "sent",
                    "id": identifier,
                    "payload": base64.b64encode(payload).decode(),
                }
            )
            self._journal.enqueue(identifier, payload)

    def _greet(self) -> None:
        self._hello.put(self.sender.greeting().wire())

    # --- telling ----------------------------------------------------------------------------------

    def _publish_status(self, *, force: bool = False) -> None:
        payload = self.status().wire()
        self._status.put(payload)
        if force or self._health_due.ready(time.monotonic()):
            write_atomically(self._config.run_dir / CONTROLLER_STATUS, payload)

    def status(self) -> ControllerStatus:
        """What the dashboard is told."""
        record = self.sender.record
        journal = self._journal
        idle = record.message >= journal.queued
        shown = min(record.message, journal.queued - 1)
        payload = journal.payload(shown) if shown >= 0 else None
        length = 0 if payload is None else frame_length(len(payload), self.sender.rules.size)
        try:
            set_index = self._config.law.index(record.x) if record.x else -1
        except LookupError:
            set_index = -1
        self._seq += 1
        return ControllerStatus(
            seq=self._seq,
            t_ns=time.time_ns(),
            phase=self._phase,
            detail=self._detail,
            scenario=self._config.scenario.name,
            seeded=self._config.seed is not None,
            session=record.session,
            k=record.k,
            set_index=set_index,
            horizon=self._config.law.design.horizon,
            transitions=record.transitions,
            agreements=record.agreements,
            garbage=self._garbage.total,
            automaton=1 if record.s == 1 else 2,
            sent_symbols=record.p,
            sending="" if payload is None else readable(payload),
            frame_symbols=length if idle else record.offset,
            frame_length=length,
            queue=max(0, journal.queued - record.message - 1),
            delivered=record.message,
        )


def run_controller(
    config: ControllerConfig, field: Bus, ops: Bus, stopping: threading.Event
) -> int:
    """Run the controller service on open buses; returns the exit code."""
    return ControllerService(config, field, ops, stopping).run()
