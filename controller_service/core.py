"""The controller's end of the link, sans I/O: what happens to a message, and when.

A step goes as in Fig. 6 of the paper: a measurement comes, the transition that it reports is judged
and moves the automaton, the next cipher symbol is decided, and the offer is saved and said
(:meth:`ControllerCore._measured`). The rest of the counting waits until the offer is on its way
(:meth:`ControllerCore._count`).

The rules are those of :mod:`protocol.link.session`. Which plant's session is served stands in
:mod:`protocol.link.controller_session`.
"""

from collections.abc import Callable
from math import inf
from typing import Final, Literal, NamedTuple
from zlib import crc32

from pydantic import ValidationError

from controller_service.alarms import NO_TEST, Tested, alarm_of, first, tested
from controller_service.outgoing import Outgoing
from controller_service.telemetry import ControllerTelemetry, MessageQueue, Phase
from protocol.agreement import NO_SYMBOL
from protocol.link.controller_session import ControllerSession
from protocol.link.distiller import Distiller
from protocol.link.effects import Effects, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import (
    BLOCKS_DIFFER,
    DOES_NOT_FOLLOW,
    ELSEWHERE,
    FELL_BACK,
    MET,
    PowerFailed,
    SessionBegan,
)
from protocol.link.key_events import appeared, block_notices, extraction_done
from protocol.link.pacing import HEALTH_S, STATUS_S, next_turn, phase_of
from protocol.link.records import INITIAL_ID, Loaded, SenderRecord
from protocol.link.session import Counted, CountedTransition, Rules, reports
from protocol.link.step import IDLE, Answered, Begun, Idle, Read
from protocol.messages import (
    LARGEST_COUNT,
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantHello,
    SendCommand,
    SendReply,
    StopKeys,
)
from protocol.schemes.framing import MAX_PAYLOAD
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed
from protocol.secret.nonces import NonceSource
from protocol.secret.stream import NOWHERE, Position
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import USAGE

REMEMBERED_SESSIONS: Final = 16
"""Ended sessions that a controller remembers, so that a delayed hello cannot revive one."""

LARGEST_STATE: Final = 1e150
"""Largest component of a state: sums and quotients of larger ones may be infinite."""

STALE: Final = 64
"""Old measurements in a row, counted once in :data:`STALE_S`, after which the session ends: the
journal is ahead of the plant, for it answered a step that the plant never made."""

STALE_S: Final = 0.04
"""Seconds in which any number of old measurements count once: a paused process or a replay brings
hundreds at once, and they say nothing of the journal. A plant repeats its own each 0.05 s."""

HALTED: Final = (
    "an alarm has ended the offers (look at the plant, then wyner controller --clear-alarm)"
)

Predict = Callable[[Vector, Vector], Vector]
"""A nonlinear f_c: (x, u) -> the predicted state; LookupError where it has none."""


NEW: Final = Loaded[SenderRecord]()
"""A journal that nothing was saved in."""


class _Reported(NamedTuple):
    """What a measurement leads to.

    ``following`` is the record that follows, but for what the answer adds. ``counted`` is None
    where no new transition is reported.
    """

    following: SenderRecord
    counted: Counted | None = None
    test: Tested = NO_TEST


class ControllerCore:
    """The controller's end of one loop.

    Parameters
    ----------
    rules : Rules
    propose : callable
        x -> M candidate inputs; raises `LookupError` where the law has no answer.
    messages : MessageQueue
        To deliver, in order.
    fresh : SymbolSource
        Random cipher symbols.
    instance : str
        Random id of this process.
    period_s : float
        The plant's; one that has been silent for several of them is away.
    loaded : Loaded
        As read back from the journal.
    predict : callable, optional
        f_c, where it is not linear.
    message : bytes, optional
        Queued under `INITIAL_ID` at the start, once, however often the process is started.
    telemetry : ControllerTelemetry, optional
        What is told beside the record; without it no status is published.
    status_s : float
        Seconds between statuses.
    nonces : NonceSource

    Attributes
    ----------
    record : SenderRecord
        What came of all steps that are counted.
    step : Idle or Answered
        The step after it.
    now, stale_at : float
        What time it was told last, and when an old measurement counts again.
    session, outgoing, keys : ControllerSession, Outgoing, Distiller
        The machines that it is made of, each with a state of its own.
    """

    hears: tuple[type[Message], ...] = (Measurement, PlantHello, SendCommand, StopKeys)
    says: tuple[type[Message], ...] = (Offer, ControllerHello, SendReply, ControllerStatus)

    def __init__(
        self,
        rules: Rules,
        propose: Callable[[Vector], tuple[Vector, ...]],
        messages: MessageQueue,
        fresh: SymbolSource,
        *,
        instance: str,
        period_s: float,
        loaded: Loaded[SenderRecord] = NEW,
        predict: Predict | None = None,
        message: bytes | None = None,
        telemetry: ControllerTelemetry | None = None,
        status_s: float = STATUS_S,
        nonces: NonceSource = fresh_nonce,
    ) -> None:
        read = loaded.record or SenderRecord()
        step = loaded.step
        assert not isinstance(step, Begun | Read)
        self.rules = rules
        self.instance = instance
        self.code: int | None = None
        self.malformed = 0
        self.messages = messages
        self.now = self.stale_at = -inf
        self.record = read._replace(
            state=rules.scheme.restore(read.state), incarnation=_after(read.incarnation)
        )
        self.step: Idle | Answered = step
        self.session = ControllerSession(instance, rules.fingerprint, period_s)
        self.outgoing = Outgoing(rules, messages, fresh)
        self.keys = Distiller(rules.schedule, rules.size, nonces)
        if read.session is not None:
            said = read if isinstance(step, Idle) else step.offer
            newest = read.offer if isinstance(step, Idle) else step.offer
            named = NOWHERE if newest is None else newest.position
            self.keys.begin(
                read.session,
                said.block,
                said.tag,
                read.confirmed,
                loaded.rows,
                loaded.held,
                Position(named.block, named.at + rules.digits),
            )
        if read.refuted:
            self.keys.fail(read.refuted)
        self._propose, self._predict = propose, predict
        self._stale = 0
        self._fell_back = loaded.fell_back
        self._first_message = message
        self._telemetry = telemetry
        self._status_s = status_s
        self._status_at = inf
        self._health_at = -inf

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""
        return self.keys.on

    @property
    def refused(self) -> bool:
        """Whether the only plant shares another model: there is nothing to go on with."""
        return self.session.state == "refused"

    @property
    def carries(self) -> bool:
        """Whether the transition to come carries a message symbol."""
        return self.rules.scheme.pad(self.record.state) != NO_SYMBOL

    @property
    def unfinished(self) -> bool:
        """Whether an offer, given now or read back from the journal, waits to be counted."""
        return self.step is not IDLE

    @property
    def reported(self) -> int:
        """Transitions that the plant has reported, the one that waits to be counted included."""
        record, step = self.record, self.step
        counts = isinstance(step, Answered) and reports(record, step.measurement)
        return record.transitions + counts

    # --- what the shell calls ---------------------------------------------------------------------

    def start(self, now: float) -> Effects:
        """Count what a journal left to be counted, queue the first message, and greet."""
        self.now = now
        if self._telemetry is not None:
            self._status_at = now
        if self._fell_back:
            yield Tell(PowerFailed())
        if isinstance(self.step, Answered):
            measurement, offer = self.step
            yield from self._count(measurement, offer, self._report(measurement, offer.cipher))
        if self._fell_back and self.record.session is not None:
            self._drop_session()
            yield Tell(SessionBegan(None, FELL_BACK))
            yield self._save()
        message = self._first_message
        if message is not None and self.messages.crc_of(INITIAL_ID) is None:
            yield from self._queue(SendCommand(id=INITIAL_ID, payload=message))
        yield self._save()  # first: no other process may greet as this incarnation
        yield Publish(self.session.hello(self.record))
        yield from map(Extract, self.keys.tasks())
        if self.record.halted:
            yield self._refusal(HALTED)

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Effects:
        """A measurement, a hello of the plant, or the operator's command."""
        self.now = now
        try:  # what is received, and that alone: a wrong message of this end's own is a fault in it
            if kind is Measurement:
                return self._measured(Measurement.from_wire(payload))
            if kind is PlantHello:
                return self._heard_hello(PlantHello.model_validate_json(payload))
            if kind is SendCommand:
                return self._commanded(SendCommand.model_validate_json(payload))
            if kind is StopKeys:
                return self._stop_keys(StopKeys.model_validate_json(payload))
        except ValidationError as error:
            names = {Measurement: "measurement", PlantHello: "hello"}
            what = names.get(kind, "command")
            return self._malformed(f"{what}: {error.error_count()} fields not as expected; ignored")
        raise TypeError(f"{kind.__name__}: expected one of {self.hears}")

    def wake_at(self) -> float:
        """When the next status is due."""
        return self._status_at

    def wake(self, now: float) -> Effects:
        """A status, if it is due."""
        self.now = now
        if now < self._status_at:
            return ()
        self._status_at = next_turn(now, self._status_s, phase_of(self.instance))
        return self._status()

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Effects:
        """A key block is extracted, or none can be any more."""
        return extraction_done(self.keys, block)

    def appear(self, count: int) -> Effects:
        """From now on a message leaves ``count`` times."""
        return appeared(self.keys, self.record.session, self.record.k, count)

    def stop(self, now: float) -> Effects:
        """The last status."""
        self.now = now
        if self._telemetry is not None and self._telemetry.phase != "refused":
            self._telemetry.phase = "stopped"
        self._health_at = now
        if self.step is IDLE:  # digits that have served are erased now, and else with the next step
            yield self._save()
        yield from self._status()

    # --- a step: measurement, verdict, next symbol, offer -----------------------------------------

    def _measured(self, measurement: Measurement) -> Effects:
        """Judge what it reports, decide, offer (rules 2 and 3); then count."""
        assert self.step is IDLE, "the step before has not been counted"
        record, session = self.record, self.session
        if wrong := self._malformed_states(measurement):
            yield from self._malformed(f"{wrong}; ignored")
            return
        if not session.serves(measurement, record):
            if session.stranger(measurement) == "remind":
                yield from self._remind()
            return
        session.plant_at = self.now
        if measurement.k < record.k:
            yield from self._old(measurement)
            return
        self._stale = 0
        before = record.offer
        if before is not None and measurement.k == before.k:
            if measurement.applied_k == record.applied_k and measurement.x == record.x:
                self._set_phase("running")
                yield Publish(self.keys.again(before))
            else:
                yield from self._diverged(measurement)
            return
        if measurement.applied_k != record.applied_k and (
            before is None or measurement.applied_k != before.k or not measurement.x_after
        ):
            yield from self._diverged(measurement)
            return
        reported = self._report(measurement)
        following = reported.following
        if following.halted and record.halted:
            return
        offer = HALTED if following.halted else self._offer(measurement, following)
        if isinstance(offer, str):  # what the measurement reports counts all the same
            self._set_phase("alarmed" if following.halted else "outside", self._detail)
            yield self._refusal(offer)
            yield from self._count(measurement, None, reported)
            return
        self.step = Answered(measurement, offer)
        self._set_phase("running")
        yield self._save()
        yield Publish(offer)
        yield from self._count(measurement, offer, reported)

    def _offer(self, measurement: Measurement, following: SenderRecord) -> Offer | str:
        """The answer to a measurement, or why there is none."""
        try:
            missed = measurement.k - measurement.applied_k - 1
            box = self.rules.box(following.estimate, missed, measurement.x)
            x = measurement.x if box is None else box.centre
            candidates = self._propose(x)
            predictions = self._predictions(x, candidates)
        except LookupError as error:
            return str(error)
        block, tag = self.keys.announcement()
        position = self._next_position(block)
        count = self.rules.digits
        digits = self.keys.stream.at(position, count) if count else None
        return Offer(
            session=measurement.session,
            k=measurement.k,
            candidates=candidates,
            predictions=predictions,
            cipher=self.outgoing.cipher(following, digits),
            copy_number=self.keys.copy(),
            nonce=self.keys.nonce(),
            heard=measurement.copy_number,
            block=block,
            tag=tag,
            stream_block=position.block if count else None,
            stream_at=position.at if count else None,
        )

    def _old(self, measurement: Measurement) -> Effects:
        """It is of a step that was answered before: held back by the network, or replayed."""
        if self.now >= self.stale_at:
            self.stale_at = self.now + STALE_S
            self._stale += 1
        return () if self._stale < STALE else self._diverged(measurement)

    def _malformed_states(self, measurement: Measurement) -> str:
        """What is wrong with a measurement's vectors; nothing where they are the plant's."""
        n = self.rules.states
        if len(measurement.x) != n:
            return f"measurement.x: got {len(measurement.x)} states, expected {n}"
        if len(measurement.x_after) not in (0, n):
            size = len(measurement.x_after)
            return f"measurement.x_after: got {size} states, expected {n} or none"
        if max(map(abs, measurement.x + measurement.x_after)) > LARGEST_STATE:
            return f"measurement: got a state beyond {LARGEST_STATE:g}"
        return self.rules.malformed_digits("measurement.keyed", measurement.keyed)

    def _predictions(self, x: Vector, candidates: tuple[Vector, ...]) -> tuple[Vector, ...]:
        """f_c(x, u_i) where f_c is not linear; raises LookupError where it has no answer."""
        if not self.rules.predicted:
            return ()
        assert self._predict is not None, "a nonlinear f_c is the controller's to bring"
        return tuple([self._predict(x, u) for u in candidates])

    def _report(self, measurement: Measurement, decided: int | None = None) -> _Reported:
        """Judge the offer that ``measurement`` reports as applied; decide the next symbol.

        Where it reports no new transition, the symbol decided before stays. ``decided`` is the
        cipher symbol of an answer that was given before.
        """
        record, rules = self.record, self.rules
        offer, counted = record.offer, None
        if record.k < 0:
            following, test = record, first(rules, record)
        elif offer is None or not reports(record, measurement):
            return _Reported(record)
        else:
            digits = self._served(offer, measurement)
            counted = rules.count(record, offer, measurement.x_after, digits)
            test = tested(rules, record, offer, counted)
            if rules.scheme.from_stream and not digits:
                # the symbol was not carried: it comes again
                following = record._replace(state=counted.state)
            else:
                following = self.outgoing.following(record, counted.state, decided)
        kept = (record.failed, record.unwatched, record.halted)
        if (test.failed, test.unwatched, test.halted) != kept:
            following = following._replace(
                failed=test.failed, unwatched=test.unwatched, halted=test.halted
            )
        if counted is not None and counted.verdict.estimate is not None:
            following = following._replace(estimate=counted.verdict.estimate)
        return _Reported(following, counted, test)

    def _served(self, offer: Offer, measurement: Measurement) -> tuple[int, ...]:
        """The digits of an applied offer, where the plant says that they served."""
        if not measurement.keyed:
            return ()
        return self.keys.stream.at(offer.position, self.rules.digits) or ()

    def _next_position(self, announced: int) -> Position:
        """Where the next offer's digits begin.

        They are of blocks that this end has announced: the plant has confirmed those, or does by
        this offer.
        """
        if not self.rules.digits or self.record.refuted:
            return NOWHERE
        return self.keys.stream.name(self.rules.digits, announced)

    # --- and then: count --------------------------------------------------------------------------

    def _count(
        self,
        measurement: Measurement,
        offer: Offer | None,
        reported: _Reported,
    ) -> Effects:
        """Bring the record up to the answer given: the transition that it reports, if any."""
        before, (following, counted, test) = self.record, reported
        self.step = IDLE
        self.keys.heard(measurement)
        transition = delivered = alarm = None
        if counted is not None:
            assert before.offer is not None
            if following.message != before.message:
                delivered = self._queued(before.message)
            transition = self._transition(before, measurement, counted, test.expected, delivered)
            if self._telemetry is not None:
                self._telemetry.counted(transition)
        if test.reason:
            alarm = alarm_of(self.rules, measurement, transition, before.offer, test.reason)
            if self._telemetry is not None:
                self._telemetry.alarmed(alarm)
        said, nonce = offer or before, before.nonce
        if offer is not None:
            nonce = "" if measurement.copy_number else measurement.nonce
        self.record = following._replace(
            k=measurement.k,
            x=measurement.x,
            offer=offer,
            applied_k=before.applied_k if transition is None else transition.k,
            transitions=before.transitions + (transition is not None),
            agreements=before.agreements
            + (transition is not None and transition.symbol != NO_SYMBOL),
            p=before.p if transition is None else transition.p,
            nonce=nonce,
            block=said.block,
            tag=said.tag,
        )
        if before.offer is not None and self.rules.digits:
            self.keys.used(before.offer.position, self.rules.digits)
        ended = self.keys.ended()
        for block in ended:
            yield Tell(block)
        if transition is not None:
            yield Tell(transition)
        if alarm is not None:
            yield Tell(alarm)
        if delivered is not None or offer is None:  # else the next step saves the record
            yield self._save(durable=delivered is not None)
        if self.keys.on:
            yield from map(Extract, self.keys.tasks())
        if delivered is not None:
            self._status_soon()
            yield Notice(f"message {delivered.id} delivered")
        if alarm is not None:
            yield Notice(alarm.sentence(), "error", "alarms")
        if ended:
            yield from block_notices(self.keys, ended)
        if any(block.what == "unequal" for block in ended):
            yield from self._end_session("blocks differ", BLOCKS_DIFFER)

    def _transition(
        self,
        before: SenderRecord,
        measurement: Measurement,
        counted: Counted,
        expected: int,
        delivered: SendCommand | None,
    ) -> CountedTransition:
        """The transition that the record's offer made of it, with its row of keys."""
        applied = before.offer
        assert applied is not None
        contribution = self.keys.count(
            before.transitions,
            applied.k - before.applied_k,
            applied,
            measurement.applied_copy,
            before.nonce,
        )
        carried = counted.carry.pad != NO_SYMBOL
        return CountedTransition.of(
            self.rules.scheme,
            before,
            applied,
            measurement.x_after,
            counted,
            before.message_symbol if carried else NO_SYMBOL,
            contribution,
            expected=expected,
            delivered=delivered,
        )

    def _save(self, queued: SendCommand | None = None, *, durable: bool = False) -> Save:
        """The record and the step as they are now, with all that belongs to them."""
        if self.record.confirmed != self.keys.confirmed:
            self.record = self.record._replace(confirmed=self.keys.confirmed)
        return Save(self.record, self.step, self.keys.rows(), "", queued, None, durable)

    def _queued(self, number: int) -> SendCommand:
        """Message ``number``, as it was handed over."""
        payload = self.messages.payload(number)
        assert payload is not None
        return SendCommand(id=self.messages.identifier(number), payload=payload)

    # --- sessions ---------------------------------------------------------------------------------

    def _heard_hello(self, hello: PlantHello) -> Effects:
        """The plant spoke on the management bus: do as the table says."""
        session = self.session
        what, answer = session.hears(hello, self.record, self.now)
        match answer:
            case "greet":
                yield Publish(session.hello(self.record))
            case "catch up and greet":
                self.record = self.record._replace(incarnation=_after(hello.incarnation))
                yield self._save()
                yield Publish(session.hello(self.record))
            case "remind":
                yield from self._remind()
            case "serve" | "adopt and serve":
                yield from self._serve(hello)
            case "refuse":
                # The session here is over once the plant begins another. Whoever asks may be gone
                # for long: its hello may come late, and ends nothing.
                why = "the plant is in a session this journal does not know"
                if what == "asked, session does not fit":
                    why = "the journals do not fit together"
                yield Publish(session.hello(self.record, "unknown-session", hello))
                yield self._refusal(why)
            case "step back" | "end and step back":
                yield from self._step_back(hello, ends=answer == "end and step back")
            case "log":
                text = f"plant {hello.instance} speaks up while plant {session.plant} runs: "
                yield self._refusal(f"{text}two plants on one loop?")
            case "say model" | "give up":
                yield from self._other_model(hello, gives_up=answer == "give up")

    def _serve(self, hello: PlantHello) -> Effects:
        """Take up a session, the journal's or a new one. A repeated request is answered again."""
        session = self.session
        known = (session.plant, self.record.session)
        if hello.session != self.record.session:
            self._adopt(hello.session)
            yield Tell(SessionBegan(hello.session, MET))
            yield self._save()
        session.plant = hello.instance
        yield Publish(session.hello(self.record, "accepted", hello))
        if (hello.instance, hello.session) != known:
            self._set_phase("running")
            yield Notice(f"session {hello.session} taken up with plant {hello.instance}")

    def _adopt(self, session: str) -> None:
        """Begin a session; the frame under way starts again."""
        unwatched = self.record.unwatched
        if self.rules.keyed:  # of the last step of the session before nobody has heard
            unwatched = self.rules.watch.unheard(unwatched)
        record = self._no_session()._replace(session=session, unwatched=unwatched)
        self.record = self.outgoing.decide(record, record.state, 0, record.message, 0)
        self._stale = 0
        self.keys.begin(session)

    def _no_session(self) -> SenderRecord:
        """What is left of the record once its session is over: the message starts again."""
        record = self.record
        ended = record.ended
        if record.session is not None:
            ended = (*ended, record.session)[-REMEMBERED_SESSIONS:]
        return SenderRecord(
            ended=ended,
            state=self.rules.scheme.initial,
            message=record.message,
            incarnation=record.incarnation,
            halted=record.halted,
            refuted=record.refuted,
            unwatched=record.unwatched,
        )

    def _drop_session(self) -> None:
        """Forget the session and its half-agreed key."""
        self.session.plant = None
        self.record = self._no_session()
        self.keys.begin("")
        self._set_phase("greeting", self._detail)

    def _end_session(
        self, what: Literal["does not follow", "blocks differ"], why: str, said: str = ""
    ) -> Effects:
        """One of the two ends went back in time: end the session, and greet."""
        self.session.on(what)
        self._drop_session()
        yield Tell(SessionBegan(None, why))
        yield self._save()
        yield from self._remind()
        yield self._refusal(said or f"{why}; session ended")

    def _diverged(self, measurement: Measurement) -> Effects:
        """The plant reports what this journal rules out."""
        text = f"measurement {measurement.k} does not follow from the journal; session ended"
        return self._end_session("does not follow", DOES_NOT_FOLLOW, text)

    def _step_back(self, hello: PlantHello, *, ends: bool) -> Effects:
        """The plant asks another controller, or is with one: offer nothing in that session."""
        why = f"plant {hello.instance} is with controller {hello.controller}, and not with "
        why += f"this one, {self.instance}"
        self.session.plant = None
        self._set_phase("greeting", self._detail)
        if ends:
            self._drop_session()
            yield Tell(SessionBegan(None, ELSEWHERE))
            yield self._save()
        yield self._refusal(why)

    def _other_model(self, hello: PlantHello, *, gives_up: bool) -> Effects:
        """The two ends cannot work together."""
        refusal = self._refusal(f"plant {hello.instance} shares another model")
        detail = (
            f"the plant's model is {hello.fingerprint[:8]}, "
            f"this controller's is {self.rules.fingerprint[:8]}"
        )
        if gives_up:
            self.code = USAGE
            self._set_phase("refused", detail)
        yield Publish(self.session.hello(self.record, "other-model", hello))
        yield refusal
        if gives_up:
            yield Notice(f"{detail}: the two ends must share one scenario", "error")

    def _remind(self) -> Effects:
        """Greet, but not too often."""
        if self.session.may_greet(self.now):
            yield Publish(self.session.hello(self.record))

    def _refusal(self, text: str) -> Notice:
        if self._telemetry is not None:
            self._telemetry.detail = text
        return Notice(text, "warning", "refusals")

    def _malformed(self, text: str) -> Effects:
        self.malformed += 1
        return (Notice(text, "warning", "malformed"),)

    # --- keys -------------------------------------------------------------------------------------

    def _stop_keys(self, command: StopKeys) -> Effects:
        """The claim that keys rest on is refuted: no more are made, and no offer has digits."""
        if self.record.refuted or not self.keys.on:
            return
        self.record = self.record._replace(refuted=command.reason)
        self.keys.fail(command.reason)
        self._status_soon()
        yield self._save(durable=True)
        yield Notice(f"keys stop: {command.reason}", "error")

    # --- commands ---------------------------------------------------------------------------------

    def _commanded(self, command: SendCommand) -> Effects:
        """The operator hands over a message; the same identifier is queued once."""
        size, queued = len(command.payload), self.messages.crc_of(command.id)
        waiting = self.messages.queued - self.record.message
        accepted, detail = False, ""
        if command.id == INITIAL_ID:
            detail = f"id: {INITIAL_ID!r} is the message that the controller is started with"
        elif size > MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected at most {MAX_PAYLOAD}"
        elif queued is None:
            accepted = True
            waiting += 1
            yield from self._queue(command)
        elif queued == crc32(command.payload):
            accepted, detail = True, "already queued"
        else:
            detail = f"id: {command.id!r} is another message's"
        yield Publish(SendReply(id=command.id, accepted=accepted, queued=waiting, detail=detail))

    def _queue(self, command: SendCommand) -> Effects:
        """Traced first: what is queued in the journal must not be missing from the trace.

        The record goes with it. The step under way was decided without this message: should it be
        counted again, then so too. On the disk before it is accepted.
        """
        yield Tell(command)
        yield self._save(command, durable=True)

    # --- the status -------------------------------------------------------------------------------

    def status(self) -> ControllerStatus:
        """What the dashboard is told; a controller without telemetry has none."""
        assert self._telemetry is not None
        return self._telemetry.status(
            self.record, self.rules, self.keys, self.messages, self.malformed
        )

    def _status(self) -> Effects:
        """A status to publish, and once in :data:`HEALTH_S` to be kept."""
        if self._telemetry is None:
            return
        status = self.status()
        yield Publish(status)
        if self.now >= self._health_at:
            self._health_at = self.now + HEALTH_S
            yield Show(status)

    def _set_phase(self, phase: Phase, detail: str = "") -> None:
        """Set the status's phase and detail."""
        if self._telemetry is not None:
            self._telemetry.phase, self._telemetry.detail = phase, detail

    @property
    def _detail(self) -> str:
        return "" if self._telemetry is None else self._telemetry.detail

    def _status_soon(self) -> None:
        """Have a status published and kept at the next wake, which is then due at once."""
        if self._telemetry is not None:
            self._status_at = self._health_at = self.now


def _after(incarnation: int) -> int:
    return min(incarnation + 1, LARGEST_COUNT)
