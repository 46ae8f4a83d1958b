"""The controller's end of the link with its timers, sans I/O."""

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Final

from pydantic import ValidationError

from controller_service.telemetry import ControllerTelemetry, Messages, Phase
from protocol.link.events import Delivered, Event, Queued, SessionBegan
from protocol.link.key_events import appeared, key_actions, waiting_notice
from protocol.link.pacing import HEALTH_S, STATUS_S, next_turn, phase_of
from protocol.link.peer import NOTHING_TO_DO, Actions, Append, Notice, Outgoing, Save
from protocol.link.sender import Sender
from protocol.link.sender_session import SenderEffects
from protocol.link.session import SILENCE_S
from protocol.messages import (
    BlockAnnouncement,
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantHello,
    SendCommand,
    SendReply,
    Status,
)
from protocol.schemes.framing import MAX_PAYLOAD
from protocol.secret.tasks import Done
from runtime.errors import USAGE

GREETING_S: Final = 0.1
"""Seconds between greetings while the plant speaks of a session that is not this process's."""

SILENT_PERIODS: Final = 3
"""A plant counts as away after so many of its periods at least, however long they are."""

INITIAL_ID: Final = "initial"
"""Identifier of the message that a controller is started with; no command may take it."""


class ControllerPeer:
    """The controller's end of one loop.

    Parameters
    ----------
    sender : Sender
    messages : Messages
        The queue that ``sender`` reads.
    period_s : float
        The plant's; one that has been silent for several of them is away.
    message : bytes, optional
        Queued under `INITIAL_ID` at the start, once in the queue's life.
    telemetry : ControllerTelemetry, optional
        What is told beside the record; without it no status is published.
    status_s : float
        Seconds between statuses.
    """

    hears: tuple[type[Message], ...] = (Measurement, PlantHello, SendCommand, BlockAnnouncement)
    says: tuple[type[Message], ...] = (
        Offer,
        ControllerHello,
        SendReply,
        ControllerStatus,
        BlockAnnouncement,
    )

    def __init__(
        self,
        sender: Sender,
        messages: Messages,
        period_s: float,
        *,
        message: bytes | None = None,
        telemetry: ControllerTelemetry | None = None,
        status_s: float = STATUS_S,
    ) -> None:
        self.sender = sender
        self.malformed = 0
        self.code: int | None = None
        self.messages = messages
        self._message = message
        self._running_s = max(SILENCE_S, SILENT_PERIODS * period_s)
        self._telemetry = telemetry
        self._status_s = status_s
        self._status_at = inf
        self._health_at = self._greeting_at = self._plant_at = -inf
        self._now = -inf
        self._later: deque[Callable[[], Actions]] = deque()

    # --- the shell's side -------------------------------------------------------------------------

    def start(self, now: float) -> Actions:
        """Count what a journal left to be counted, queue the first message, and greet."""
        self._now = now
        if self._telemetry is not None:
            self._status_at = now
        if self.sender.unfinished:
            self._later.append(self._finish_step)
        if self._message is not None and self.messages.queued_as(INITIAL_ID) is None:
            message = self._message
            self._later.append(lambda: self._queue(INITIAL_ID, message))
        self._later.append(self._begin)
        return self.finish_step()

    def _begin(self) -> Actions:
        """Greet, as a life that the journal knows."""
        sender = self.sender
        write = Save(sender.record)
        return Actions(write=write, publish=(self._greeting(),), keys=sender.keying.tasks())

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """A measurement, a word of the plant's, or the operator's command."""
        self._now = now
        try:
            if kind is Measurement:
                return self._measured(payload, now)
            if kind is PlantHello:
                return self._heard(PlantHello.model_validate_json(payload), now)
            if kind is BlockAnnouncement:
                return self._heard_announcement(BlockAnnouncement.model_validate_json(payload))
            return self._commanded(SendCommand.model_validate_json(payload))
        except ValidationError as error:
            names = {Measurement: "measurement", PlantHello: "hello", BlockAnnouncement: "word"}
            what = names.get(kind, "command")
            return self._malformed(f"{what}: {error.error_count()} fields not as expected; ignored")

    def wake_at(self) -> float:
        """When the next status is due."""
        return self._status_at

    def wake(self, now: float) -> Actions:
        """A status, if it is due."""
        self._now = now
        if now < self._status_at:
            return NOTHING_TO_DO
        self._status_at = next_turn(now, self._status_s, phase_of(self.sender.instance))
        publish, health = self._status(force=False)
        return Actions(publish=publish, health=health)

    def finish_step(self) -> Actions:
        """The next of what was left for later."""
        actions = self._later.popleft()()
        return actions._replace(finish_step=True) if self._later else actions

    def appear(self, count: int) -> Actions:
        """From now on a message leaves ``count`` times."""
        record = self.sender.record
        return appeared(self.sender.keying, record.session, record.k, count)

    def stop(self, now: float) -> Actions:
        """The last status."""
        self._now = now
        if self._telemetry is not None and self._telemetry.phase != "refused":
            self._telemetry.phase = "stopped"
        publish, health = self._status(force=True)
        return Actions(
            write=self._erase_rows(),
            publish=publish,
            notices=waiting_notice(self.sender.keying),
            health=health,
        )

    def status(self) -> ControllerStatus:
        """What the dashboard is told; an endpoint without telemetry has none."""
        assert self._telemetry is not None
        return self._telemetry.status(self.sender, self.messages, self.malformed)

    # --- steps ------------------------------------------------------------------------------------

    def _measured(self, payload: bytes, now: float) -> Actions:
        sender = self.sender
        measurement = Measurement.model_validate_json(payload)
        try:
            effects = sender.measured(measurement)
        except ValueError as error:
            return self._malformed(f"{error}; ignored")
        if sender.plant is not None and measurement.session == sender.record.session:
            self._plant_at = now
        telemetry = self._telemetry
        if telemetry is not None and effects.offer is not None:
            telemetry.phase, telemetry.detail = "running", ""
        elif telemetry is not None and effects.refusal:
            telemetry.phase = "outside" if sender.record.session else "greeting"
        if not effects.append:
            return self._actions(effects)
        assert effects.offer is not None
        offer = effects.offer.wire()
        self._later.append(self._finish_step)
        return Actions(
            write=Append(payload, offer), publish=(Outgoing(Offer, offer),), finish_step=True
        )

    def _finish_step(self) -> Actions:
        sender = self.sender
        effects = sender.finish_step()
        actions = self._actions(effects)
        obsolete_rows = sender.keying.obsolete_rows()
        # Rows that go cost a rare write: now, and not when a step hangs on it.
        later = not (effects.save or obsolete_rows)
        write = Save(
            sender.record,
            later=later,
            contribution=effects.contribution,
            obsolete_rows=obsolete_rows,
        )
        actions = actions._replace(write=write, keys=sender.keying.tasks(effects.judged))
        if any(judgement.what == "unequal" for judgement in effects.judged):
            self._later.append(self._unequal)
        return actions

    def _unequal(self) -> Actions:
        effects = self.sender.unequal()
        return self._actions(effects, SessionBegan(None, effects.refusal))

    def key_task_done(self, done: Done, now: float) -> Actions:
        """The keeper of keys has done a task; rows that nobody needs any more go at once."""
        self._now = now
        actions = key_actions(self.sender.keying, done)
        return actions._replace(write=self._erase_rows())

    def _erase_rows(self) -> Save | None:
        """What has the journal erase the rows of blocks that are confirmed, if there are any."""
        obsolete_rows = self.sender.keying.obsolete_rows()
        return Save(self.sender.record, obsolete_rows=obsolete_rows) if obsolete_rows else None

    def _heard_announcement(self, word: BlockAnnouncement) -> Actions:
        """The plant has made its last step, and waits for its last blocks."""
        sender = self.sender
        session, keying = sender.record.session, sender.keying
        if word.side != "plant" or session is None or word.session != session or not keying.on:
            return NOTHING_TO_DO
        judged = keying.heard(word)
        if any(judgement.what == "unequal" for judgement in judged):
            self._later.append(self._unequal)
            return Actions(keys=keying.tasks(judged), finish_step=True)
        answer = Outgoing(
            BlockAnnouncement, keying.block_announcement("controller", session).wire()
        )
        write = self._erase_rows()
        return Actions(write=write, publish=(answer,), keys=keying.tasks(judged))

    def _actions(self, effects: SenderEffects, *events: Event) -> Actions:
        """What the sender asks for, beside the step itself."""
        publish: list[Outgoing] = []
        notices: list[Notice] = []
        health: Status | None = None
        if effects.transition is not None:
            events = (*events, effects.transition)
            if self._telemetry is not None:
                self._telemetry.unexplained += effects.transition.verdict.unexplained
        if effects.offer is not None:
            publish.append(Outgoing(Offer, effects.offer.wire()))
        if effects.reply is not None:
            publish.append(Outgoing(ControllerHello, effects.reply.wire()))
        if effects.greet and self._now >= self._greeting_at:
            self._greeting_at = self._now + GREETING_S
            publish.append(self._greeting())
        if effects.refusal:
            if self._telemetry is not None:
                self._telemetry.detail = effects.refusal
            notices.append(Notice(effects.refusal, "warning", "refusals"))
        if effects.delivered is not None:
            delivered = self._delivered(effects.delivered)
            events = (*events, delivered)
            notices.append(Notice(f"message {delivered.identifier} delivered"))
            status, health = self._status(force=True)
            publish += status
        write = Save(self.sender.record) if effects.save else None
        return Actions(events, write, tuple(publish), tuple(notices), health)

    def _delivered(self, number: int) -> Delivered:
        payload = self.messages.payload(number)
        assert payload is not None
        return Delivered(number, self.messages.identifier(number), payload)

    # --- sessions and commands --------------------------------------------------------------------

    def _heard(self, hello: PlantHello, now: float) -> Actions:
        """The plant spoke on ops."""
        sender = self.sender
        before = (sender.plant, sender.record.session)
        effects = sender.heard_plant(hello, running=now - self._plant_at < self._running_s)
        reason = effects.refusal or "the plant began it"
        session = sender.record.session
        events = (SessionBegan(session, reason),) if session != before[1] else ()
        actions = self._actions(effects, *events)
        notice: Notice | None = None
        phase: Phase | None = None
        detail = ""
        if sender.refused:
            self.code = USAGE
            detail = (
                f"the plant's model is {hello.fingerprint[:8]}, "
                f"this controller's is {sender.rules.fingerprint[:8]}"
            )
            phase = "refused"
            notice = Notice(f"{detail}: the two ends must share one scenario", "error")
        elif sender.plant is None:
            phase = "greeting"
        elif before != (sender.plant, sender.record.session):
            phase = "running"
            notice = Notice(f"session {hello.session} taken up with plant {hello.instance}")
        if self._telemetry is not None and phase is not None:
            self._telemetry.phase = phase
            if phase != "greeting":
                self._telemetry.detail = detail
        return actions if notice is None else actions._replace(notices=(*actions.notices, notice))

    def _commanded(self, command: SendCommand) -> Actions:
        """The operator hands over a message; the same identifier is queued once."""
        size, queued = len(command.payload), self.messages.queued_as(command.id)
        waiting = self.messages.queued - self.sender.record.message
        accepted, detail, actions = False, "", NOTHING_TO_DO
        if command.id == INITIAL_ID:
            detail = f"id: {INITIAL_ID!r} is the message that the controller is started with"
        elif size > MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected at most {MAX_PAYLOAD}"
        elif queued is None:
            actions, accepted = self._queue(command.id, command.payload), True
            waiting += 1
        elif queued == command.payload:
            accepted, detail = True, "already queued"
        else:
            detail = f"id: {command.id!r} is another message's"
        reply = SendReply(id=command.id, accepted=accepted, queued=waiting, detail=detail)
        return actions._replace(publish=(Outgoing(SendReply, reply.wire()),))

    def _queue(self, identifier: str, payload: bytes) -> Actions:
        """Traced first: what is queued in the journal must not be missing from the trace.

        The record goes with it. The step under way was decided without this message: should it be
        counted again, then so too.
        """
        write = Save(self.sender.record, queued=(identifier, payload))
        return Actions(events=(Queued(identifier, payload),), write=write)

    def _greeting(self) -> Outgoing:
        return Outgoing(ControllerHello, self.sender.greeting().wire())

    # --- telling ----------------------------------------------------------------------------------

    def _status(self, *, force: bool) -> tuple[tuple[Outgoing, ...], Status | None]:
        """A status to publish, and once in :data:`HEALTH_S` to be kept."""
        if self._telemetry is None:
            return (), None
        status = self.status()
        keep = force or self._now >= self._health_at
        if keep:
            self._health_at = self._now + HEALTH_S
        return (Outgoing(ControllerStatus, status.wire()),), status if keep else None

    def _malformed(self, text: str) -> Actions:
        self.malformed += 1
        return Actions(notices=(Notice(text, "warning", "malformed"),))
