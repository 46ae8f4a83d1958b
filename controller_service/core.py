"""The controller's end of the link, sans I/O: one room for its steps, its session, its timers.

A step goes as in Fig. 6 of the paper: a measurement comes, the transition that it reports is judged
and moves the automaton, the next cipher symbol is decided, and the offer is saved and said
(:meth:`ControllerCore._measured`). The rest of the counting waits until the offer is on its way
(:meth:`ControllerCore._count`).

The rules are those of :mod:`protocol.link.session`. Which plant's session is served stands in
:mod:`protocol.link.controller_session`.
"""

from collections.abc import Callable, Iterable
from math import inf
from typing import Final, Literal, NamedTuple
from zlib import crc32

from pydantic import ValidationError

from controller_service.telemetry import ControllerTelemetry, MessageQueue, Phase
from protocol.agreement import NO_SYMBOL, AgreementResult
from protocol.link.controller_session import TABLE, State, heard
from protocol.link.distiller import Distiller
from protocol.link.events import (
    BLOCKS_DIFFER,
    DOES_NOT_FOLLOW,
    ELSEWHERE,
    FELL_BACK,
    MET,
    Alarm,
    Event,
    Reason,
    SessionBegan,
)
from protocol.link.key_events import appeared, block_notices, extraction_done
from protocol.link.pacing import HEALTH_S, STATUS_S, next_turn, phase_of
from protocol.link.peer import NOTHING_TO_DO, Actions, Notice
from protocol.link.records import INITIAL_ID, SenderRecord
from protocol.link.session import SILENCE_S, CountedTransition, Rules
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
from protocol.schemes.base import Carry, encrypt
from protocol.schemes.framing import IDLE, MAX_PAYLOAD, encode_frame
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed
from protocol.secret.nonces import Contribution, NonceSource
from protocol.secret.stream import NOWHERE, Part, Position
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import USAGE

GREETING_S: Final = 0.1
"""Seconds between greetings while the plant speaks of a session that is not this process's."""

SILENT_PERIODS: Final = 3
"""Periods of silence before a plant counts as away; :data:`SILENCE_S` at least."""

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


class _Judged(NamedTuple):
    """What the test made of the transition that a measurement reports.

    ``served`` are the digits of the key stream that it used. ``expected`` is the candidate that one
    of them chose, -1 where the transition is unwatched.
    """

    verdict: AgreementResult
    carry: Carry
    served: tuple[int, ...]
    expected: int


class _Reported(NamedTuple):
    """What a measurement leads to.

    ``following`` is the record that follows, but for what the answer adds. ``judged`` is None where
    no new transition is reported. ``alarm`` is why there is an alarm; empty: there is none.
    """

    following: SenderRecord
    judged: _Judged | None
    alarm: Reason


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
    record : SenderRecord, optional
        As read back from the journal.
    measurement, offer : optional
        The step after that record, as read back, to be counted first: what was heard, and the
        answer.
    contributions : iterable of Contribution
        Rows of key blocks that may still be needed, as read back.
    fell_back : bool
        The journal may lack its newest steps: its session ends.
    parts : iterable of Part
        Digits of the key stream that are left, as read back.
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
    now, plant_at, greeting_at, stale_at : float
        The timers, in seconds: what it was told last, when the plant measured, when it may greet
        again, when an old measurement counts again. They move together with the clock.
    running_s : float
        Seconds after which a plant that has not measured is away.
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
        record: SenderRecord | None = None,
        measurement: Measurement | None = None,
        offer: Offer | None = None,
        contributions: Iterable[Contribution] = (),
        fell_back: bool = False,
        parts: Iterable[Part] = (),
        predict: Predict | None = None,
        message: bytes | None = None,
        telemetry: ControllerTelemetry | None = None,
        status_s: float = STATUS_S,
        nonces: NonceSource = fresh_nonce,
    ) -> None:
        self.rules = rules
        self.instance = instance
        self.code: int | None = None
        self.malformed = 0
        self.messages = messages
        read = record or SenderRecord()
        self.record = read._replace(
            state=rules.scheme.restore(read.state), incarnation=_after(read.incarnation)
        )
        # the step
        self._propose = propose
        self._predict = predict
        self._under_way: tuple[Measurement, Offer, _Reported] | None = None
        """The step that waits to be counted, with what its measurement leads to."""
        self._stale = 0
        self.stale_at = -inf
        # the frame under way
        self._fresh = fresh
        self._frame: tuple[int, bytes] = (-1, b"")
        # keys
        self.keys = Distiller(rules.schedule, rules.size, nonces)
        if self.record.session is not None:
            said = offer or self.record
            newest = offer or self.record.offer
            named = NOWHERE if newest is None else newest.position
            self.keys.begin(
                self.record.session,
                said.block,
                said.tag,
                self.record.confirmed,
                contributions,
                parts,
                Position(named.block, named.at + rules.digits),
            )
        if self.record.refuted:
            self.keys.fail(self.record.refuted)
        # the session
        self._state: State = "greeting"
        self._plant: str | None = None
        self._elsewhere: str | None = None
        self.running_s = max(SILENCE_S, SILENT_PERIODS * period_s)
        self.plant_at = self.greeting_at = -inf
        # what waits for `finish_step`
        self._starting = False
        self._fell_back = fell_back and read.session is not None
        self._first_message = message
        self._blocks_differ = False
        # the status
        self._telemetry = telemetry
        self._status_s = status_s
        self._status_at = inf
        self._health_at = self.now = -inf
        if offer is not None:
            assert measurement is not None
            self._under_way = measurement, offer, self._report(measurement, offer.cipher)

    @property
    def plant(self) -> str | None:
        """The plant process whose session is taken up, if any."""
        return self._plant

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""
        return self.keys.on

    @property
    def refused(self) -> bool:
        """Whether the only plant shares another model: there is nothing to go on with."""
        return self._state == "refused"

    @property
    def carries(self) -> bool:
        """Whether the transition to come carries a message symbol."""
        return self.rules.scheme.pad(self.record.state) != NO_SYMBOL

    @property
    def unfinished(self) -> bool:
        """Whether an offer, given now or read back from the journal, waits to be counted."""
        return self._under_way is not None

    @property
    def reported(self) -> int:
        """Transitions that the plant has reported, the one that waits to be counted included."""
        counts = self._under_way is not None and self._under_way[2].judged is not None
        return self.record.transitions + counts

    # --- what the shell calls ---------------------------------------------------------------------

    def start(self, now: float) -> Actions:
        """Count what a journal left to be counted, queue the first message, and greet."""
        self.now = now
        if self._telemetry is not None:
            self._status_at = now
        if self.messages.crc_of(INITIAL_ID) is not None:
            self._first_message = None
        self._starting = True
        return self.finish_step()

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """A measurement, a hello or announcement of the plant, or the operator's command."""
        self.now = now
        try:  # what is received, and that alone: a wrong message of this end's own is a fault in it
            message = (
                Measurement.from_wire(payload)
                if kind is Measurement
                else kind.model_validate_json(payload)
            )
        except ValidationError as error:
            names = {Measurement: "measurement", PlantHello: "hello"}
            what = names.get(kind, "command")
            return self._malformed(f"{what}: {error.error_count()} fields not as expected; ignored")
        match message:
            case Measurement():
                return self._measured(message)
            case PlantHello():
                return self._heard_hello(message)
            case StopKeys():
                return self._stop_keys(message)
            case SendCommand():
                return self._commanded(message)
        raise TypeError(f"{kind.__name__}: expected one of {self.hears}")

    def wake_at(self) -> float:
        """When the next status is due."""
        return self._status_at

    def wake(self, now: float) -> Actions:
        """A status, if it is due."""
        self.now = now
        if now < self._status_at:
            return NOTHING_TO_DO
        self._status_at = next_turn(now, self._status_s, phase_of(self.instance))
        return self._status()

    def finish_step(self) -> Actions:
        """Count the step under way; what else waited for that comes after it, one at a time."""
        if self._under_way is not None:
            step, self._under_way = self._under_way, None
            actions = self._count(*step)
        elif self._blocks_differ:
            self._blocks_differ = False
            actions = self._end_session("blocks differ", BLOCKS_DIFFER)
        elif self._fell_back:
            self._fell_back = False
            self._drop_session()
            actions = self._saved(Actions((SessionBegan(None, FELL_BACK),)))
        elif self._first_message is not None:
            actions = self._queue(SendCommand(id=INITIAL_ID, payload=self._first_message))
            self._first_message = None
        else:
            assert self._starting, "nothing waits to be finished"
            self._starting = False
            # Saved first: no other process may greet as this incarnation.
            greeting = Actions(
                publish=(self._greeting(),),
                tasks=self.keys.tasks(),
                notices=(self._refusal(HALTED),) if self.record.halted else (),
            )
            actions = self._saved(greeting)
        if self._starting or self._blocks_differ:
            return actions._replace(finish_step=True)
        return actions

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Actions:
        """A key block is extracted, or none can be any more."""
        return extraction_done(self.keys, block)

    def appear(self, count: int) -> Actions:
        """From now on a message leaves ``count`` times."""
        return appeared(self.keys, self.record.session, self.record.k, count)

    def stop(self, now: float) -> Actions:
        """The last status."""
        self.now = now
        if self._telemetry is not None and self._telemetry.phase != "refused":
            self._telemetry.phase = "stopped"
        self._health_at = now
        actions = self._status()
        # between steps the digits that have served are erased now, and else with the next step
        return actions if self.unfinished else self._saved(actions)

    # --- a step: measurement, verdict, next symbol, offer -----------------------------------------

    def _measured(self, measurement: Measurement) -> Actions:
        """Judge what it reports, decide, offer (rules 2 and 3); the counting is left for later."""
        assert self._under_way is None, "the step before has not been counted"
        record = self.record
        if wrong := self._malformed_states(measurement):
            return self._malformed(f"{wrong}; ignored")
        if self._plant is None or measurement.session != record.session:
            here = measurement.session != self._elsewhere
            answer, self._state = TABLE[
                self._state, "session not taken up" if here else "session elsewhere"
            ]
            return self._remind() if answer == "remind" else NOTHING_TO_DO
        self.plant_at = self.now
        if measurement.k < record.k:
            return self._old(measurement)
        self._stale = 0
        before = record.offer
        if before is not None and measurement.k == before.k:
            if measurement.applied_k == record.applied_k and measurement.x == record.x:
                return self._offers(self.keys.again(before))
            return self._diverged(measurement)
        if measurement.applied_k != record.applied_k and (
            before is None or measurement.applied_k != before.k or not measurement.x_after
        ):
            return self._diverged(measurement)
        reported = self._report(measurement)
        following = reported.following
        if following.halted:
            if record.halted:
                return NOTHING_TO_DO
            return self._without_offer(measurement, reported, HALTED, "alarmed")
        try:
            missed = measurement.k - measurement.applied_k - 1
            box = self.rules.box(following.estimate, missed, measurement.x)
            x = measurement.x if box is None else box.centre
            candidates = self._propose(x)
            predictions = self._predictions(x, candidates)
        except LookupError as error:
            return self._without_offer(measurement, reported, str(error), "outside")
        block, tag = self.keys.announcement()
        position = self._next_position(block)
        offer = Offer(
            session=measurement.session,
            k=measurement.k,
            candidates=candidates,
            predictions=predictions,
            cipher=self._cipher(following, position),
            copy_number=self.keys.copy(),
            nonce=self.keys.nonce(),
            heard=measurement.copy_number,
            block=block,
            tag=tag,
            stream_block=position.block if self.rules.digits else None,
            stream_at=position.at if self.rules.digits else None,
        )
        self._under_way = measurement, offer, reported
        return self._offers(offer, measurement)

    def _old(self, measurement: Measurement) -> Actions:
        """It is of a step that was answered before: held back by the network, or replayed."""
        if self.now >= self.stale_at:
            self.stale_at = self.now + STALE_S
            self._stale += 1
        return NOTHING_TO_DO if self._stale < STALE else self._diverged(measurement)

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

    def _offers(self, offer: Offer, measurement: Measurement | None = None) -> Actions:
        """Publish an offer; one that was not saved before is saved, with what it answers."""
        if self._telemetry is not None:
            self._telemetry.phase, self._telemetry.detail = "running", ""
        if measurement is None:
            return Actions(publish=(offer,))
        step = Actions(offer=offer, measurement=measurement, publish=(offer,), finish_step=True)
        return self._saved(step)

    def _without_offer(
        self,
        measurement: Measurement,
        reported: _Reported,
        why: str,
        phase: Phase,
    ) -> Actions:
        """There is no answer to give: what the measurement reports counts all the same."""
        if self._telemetry is not None:
            self._telemetry.phase = phase
        actions = self._saved(self._count(measurement, None, reported))
        return actions._replace(
            notices=(self._refusal(why), *actions.notices),
            finish_step=self._blocks_differ,
        )

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
        record = self.record
        offer = record.offer
        if record.k < 0:
            return self._first()
        if offer is None or measurement.applied_k == record.applied_k:
            return _Reported(record, None, "")
        verdict = self.rules.judge(
            record.x,
            offer.candidates,
            offer.predictions,
            measurement.x_after,
            self.rules.box(record.estimate, record.k - record.applied_k - 1, record.x),
        )
        after, carry = self.rules.scheme.follow(record.state, verdict.symbol)
        served = self._served(offer, measurement)
        if self.rules.scheme.from_stream and served:
            carry = carry._replace(pad=served[-1])
        if self.rules.scheme.from_stream and not served:
            following = record._replace(state=after)  # the symbol was not carried: it comes again
        else:
            message, offset = record.message, record.offset
            # The frame is looked at in every state, as in `_decide`.
            if offset == len(self._frame_of(message)) and record.framed:
                message, offset = message + 1, 0
            following = self._decide(after, record.transitions + 1, message, offset, decided)
        if verdict.estimate is not None:
            following = following._replace(estimate=verdict.estimate)
        expected = served[0] if served and self.rules.keyed else NO_SYMBOL
        failure = self._failure(verdict, expected, offer)
        alarm, tests = self.rules.alarm_rule.test(record.failed, failed=failure != "")
        unwatched, too_many = record.unwatched, False
        if self.rules.keyed:
            watched = expected != NO_SYMBOL
            unwatched, too_many = self.rules.watch.after(unwatched, watched=watched)
        reason: Reason = failure if alarm else "unwatched" if too_many else ""
        following = following._replace(
            failed=tests,
            unwatched=unwatched,
            halted=record.halted or (reason != "" and self.rules.halts),
        )
        return _Reported(following, _Judged(verdict, carry, served, expected), reason)

    def _first(self) -> _Reported:
        """A session's first measurement: no transition, and an alarm if too many had no digit.

        Whoever ends each session at its first step would otherwise have all of them unwatched, and
        none counted.
        """
        too_many = self.rules.keyed and self.record.unwatched > self.rules.watch.burst
        if not too_many:
            return _Reported(self.record, None, "")
        halted = self.record.halted or self.rules.halts
        return _Reported(self.record._replace(unwatched=0.0, halted=halted), None, "unwatched")

    def _served(self, offer: Offer, measurement: Measurement) -> tuple[int, ...]:
        """The digits of an applied offer, where the plant says that they served."""
        if not measurement.keyed:
            return ()
        return self.keys.stream.at(offer.position, self.rules.digits) or ()

    def _failure(self, verdict: AgreementResult, expected: int, offer: Offer) -> Reason:
        """What speaks against a transition; nothing where it passes its test.

        A plant that has the offer's digits uses them. It has them: once it has announced
        their block it takes no step before it has confirmed it.
        """
        if self.rules.fails(verdict, expected):
            return "unexplained" if expected == NO_SYMBOL else "another candidate"
        if self.rules.keyed and expected == NO_SYMBOL and offer.position != NOWHERE:
            return "digits refused"
        return ""

    def _next_position(self, announced: int) -> Position:
        """Where the next offer's digits begin.

        They are of blocks that this end has announced: the plant has confirmed those, or does by
        this offer.
        """
        if not self.rules.digits or self.record.refuted:
            return NOWHERE
        return self.keys.stream.name(self.rules.digits, announced)

    def _cipher(self, following: SenderRecord, position: Position) -> int:
        """The cipher symbol of an offer."""
        if not self.rules.scheme.from_stream:
            return following.cipher
        size = self.rules.size
        digits = self.keys.stream.at(position, self.rules.digits)
        if digits is None:
            return self._fresh.symbol(following.transitions, size)
        return encrypt(following.message_symbol, digits[-1], size)

    def _decide(
        self,
        state: tuple[int, ...],
        transitions: int,
        message: int,
        offset: int,
        decided: int | None = None,
    ) -> SenderRecord:
        """Decide the cipher symbol of the transition to come: once, and never again (rule 3).

        The record that follows has it, with where in the queue the next message symbol comes from.
        Both decisions are made in both states, and one is taken, so that neither takes longer.
        Under the key stream the message symbol is decided, and each offer encrypts it anew
        (:meth:`_cipher`).
        """
        size, scheme = self.rules.size, self.rules.scheme
        pad = scheme.pad(state)
        fresh = 0
        if decided is not None:
            fresh = decided
        elif not scheme.from_stream:
            fresh = self._fresh.symbol(transitions, size)
        symbols = self._frame_of(message)
        framed = bool(symbols)
        message_symbol = symbols[offset] if framed else IDLE
        carrying = self.record._replace(
            state=state,
            cipher=0 if scheme.from_stream else encrypt(message_symbol, pad, size),
            message_symbol=message_symbol,
            framed=framed,
            message=message,
            offset=offset + framed,
        )
        cover = self.record._replace(
            state=state,
            cipher=fresh,
            message_symbol=NO_SYMBOL,
            framed=False,
            message=message,
            offset=offset,
        )
        if pad == NO_SYMBOL and not scheme.from_stream:
            return cover
        return carrying

    def _frame_of(self, message: int) -> bytes:
        """The frame of a queued message, or nothing while there is none."""
        number, symbols = self._frame
        if number != message:
            payload = self.messages.payload(message)
            if payload is None:
                return b""
            symbols = encode_frame(payload, self.rules.size)
            self._frame = (message, symbols)
        return symbols

    # --- and then: count --------------------------------------------------------------------------

    def _count(
        self,
        measurement: Measurement,
        offer: Offer | None,
        reported: _Reported,
    ) -> Actions:
        """Bring the record up to the answer given: the transition that it reports, if any."""
        before, (following, judged, reason) = self.record, reported
        if offer is not None:
            nonce = "" if measurement.copy_number else measurement.nonce
            following = following._replace(nonce=nonce, block=offer.block, tag=offer.tag)
        self.keys.heard(measurement)
        events: tuple[Event, ...] = ()
        notices: tuple[Notice, ...] = ()
        contribution, delivered = None, None
        alarm: Alarm | None = None
        if judged is None:  # no transition: the state, and the arrows from it, stay
            self.record = following._replace(k=measurement.k, x=measurement.x, offer=offer)
            if reason:
                k = measurement.k - 1
                alarm = Alarm(measurement.session, -1, k, measurement.x, reason, -1, (), 0.0)
        else:
            applied = before.offer
            assert applied is not None
            contribution = self.keys.count(
                before.transitions,
                applied.k - before.applied_k,
                applied,
                measurement.applied_copy,
                before.nonce,
            )
            if following.message != before.message:
                delivered = self._queued(before.message)
            transition = CountedTransition.of(
                self.rules.scheme,
                before,
                applied,
                measurement.x_after,
                judged.verdict,
                following.state,
                judged.carry,
                before.message_symbol if judged.carry.pad != NO_SYMBOL else NO_SYMBOL,
                contribution,
                keyed=bool(judged.served),
                expected=judged.expected,
                delivered=delivered,
            )
            self.record = following._replace(
                k=measurement.k,
                applied_k=applied.k,
                transitions=before.transitions + 1,
                agreements=before.agreements + (1 if transition.symbol != NO_SYMBOL else 0),
                p=transition.p,
                x=measurement.x,
                offer=offer,
            )
            alarm = self._alarm(transition, applied, reason) if reason else None
            if self._telemetry is not None:
                self._telemetry.counted(transition)
            events = (transition,)
            if delivered is not None:
                self._status_soon()
                notices = (Notice(f"message {delivered.id} delivered"),)
        if alarm is not None:
            if self._telemetry is not None:
                self._telemetry.alarmed(alarm)
            events = (*events, alarm)
            notices = (*notices, Notice(alarm.sentence(), "error", "alarms"))
        if before.offer is not None:
            self.keys.used(before.offer.position, self.rules.digits)
        ended = self.keys.ended()
        self._blocks_differ = any(block.what == "unequal" for block in ended)
        actions = Actions(
            (*ended, *events),
            notices=(*notices, *block_notices(self.keys, ended)),
            tasks=self.keys.tasks(),
        )
        if delivered is None:  # the next step saves the record
            return actions
        return self._saved(actions)._replace(durable=True)

    def _saved(self, actions: Actions) -> Actions:
        """``actions``, which save the record as it is now, with all that belongs to it.

        They may save it already, as it was before.
        """
        self.record = self.record._replace(confirmed=self.keys.confirmed)
        rows = self.keys.rows()
        if actions.record is not None:
            rows = actions.rows.and_then(rows)
        return actions._replace(record=self.record, rows=rows)

    def _alarm(self, transition: CountedTransition, applied: Offer, reason: Reason) -> Alarm:
        """What was read and what was expected, of a transition that makes an alarm."""
        gauges, candidate = transition.verdict.gauges, transition.expected
        if candidate == NO_SYMBOL:
            candidate = gauges.index(min(gauges))
        return Alarm(
            transition.session,
            transition.j,
            transition.k,
            transition.x_next,
            reason,
            candidate,
            self.rules.prediction(transition.x, applied, candidate, transition.verdict.box),
            gauges[candidate],
        )

    def _queued(self, number: int) -> SendCommand:
        """Message ``number``, as it was handed over."""
        payload = self.messages.payload(number)
        assert payload is not None
        return SendCommand(id=self.messages.identifier(number), payload=payload)

    # --- sessions ---------------------------------------------------------------------------------

    def _heard_hello(self, hello: PlantHello) -> Actions:
        """The plant spoke on the management bus: do as the table says."""
        record = self.record
        what = heard(
            hello,
            record,
            instance=self.instance,
            fingerprint=self.rules.fingerprint,
            plant=self._plant,
            running=self.now - self.plant_at < self.running_s,
        )
        answer, self._state = TABLE[self._state, what]
        if self._state != "elsewhere":
            self._elsewhere = None
        if answer == "greet":
            return Actions(publish=(self._greeting(),))
        if answer == "catch up and greet":
            self.record = record._replace(incarnation=_after(hello.incarnation))
            return self._saved(Actions(publish=(self._greeting(),)))
        if answer == "remind":
            return self._remind()
        if answer in ("serve", "adopt and serve"):
            return self._serve(hello)
        if answer == "refuse":
            # The session here is over once the plant begins another. Whoever asks may be gone for
            # long: its hello may come late, and ends nothing.
            why = "the plant is in a session this journal does not know"
            if what == "asked, session does not fit":
                why = "the journals do not fit together"
            reply = self._hello("unknown-session", hello)
            return Actions(publish=(reply,), notices=(self._refusal(why),))
        if answer in ("step back", "end and step back"):
            return self._step_back(hello, ends=answer == "end and step back")
        if answer == "log":
            text = f"plant {hello.instance} speaks up while plant {self._plant} runs: "
            return Actions(notices=(self._refusal(f"{text}two plants on one loop?"),))
        if answer in ("say model", "give up"):
            return self._other_model(hello, gives_up=answer == "give up")
        return NOTHING_TO_DO

    def _serve(self, hello: PlantHello) -> Actions:
        """Take up a session, the journal's or a new one. A repeated request is answered again."""
        actions = NOTHING_TO_DO
        known = (self._plant, self.record.session)
        if hello.session != self.record.session:
            self._adopt(hello.session)
            began = SessionBegan(hello.session, MET)
            actions = self._saved(Actions((began,)))
        self._plant = hello.instance
        if (hello.instance, hello.session) != known:
            if self._telemetry is not None:
                self._telemetry.phase, self._telemetry.detail = "running", ""
            text = f"session {hello.session} taken up with plant {hello.instance}"
            actions = actions._replace(notices=(Notice(text),))
        return actions._replace(publish=(self._hello("accepted", hello),))

    def _adopt(self, session: str) -> None:
        """Begin a session; the frame under way starts again."""
        unwatched = self.record.unwatched
        if self.rules.keyed:  # of the last step of the session before nobody has heard
            unwatched = self.rules.watch.unheard(unwatched)
        self.record = self._no_session()._replace(session=session, unwatched=unwatched)
        self.record = self._decide(self.record.state, 0, self.record.message, 0)
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
        self._plant = None
        self.record = self._no_session()
        self.keys.begin("")
        if self._telemetry is not None:
            self._telemetry.phase = "greeting"

    def _end_session(
        self, what: Literal["does not follow", "blocks differ"], why: str, said: str = ""
    ) -> Actions:
        """One of the two ends went back in time: end the session, and greet."""
        _, self._state = TABLE[self._state, what]
        self._drop_session()
        refusal = self._refusal(said or f"{why}; session ended")
        return self._saved(self._remind())._replace(
            events=(SessionBegan(None, why),), notices=(refusal,)
        )

    def _diverged(self, measurement: Measurement) -> Actions:
        """The plant reports what this journal rules out."""
        text = f"measurement {measurement.k} does not follow from the journal; session ended"
        return self._end_session("does not follow", DOES_NOT_FOLLOW, text)

    def _step_back(self, hello: PlantHello, *, ends: bool) -> Actions:
        """The plant asks another controller, or is with one: offer nothing in that session."""
        self._elsewhere = hello.session
        why = f"plant {hello.instance} is with controller {hello.controller}, and not with "
        why += f"this one, {self.instance}"
        actions = Actions(notices=(self._refusal(why),))
        if ends:
            self._drop_session()
            actions = self._saved(actions)._replace(events=(SessionBegan(None, ELSEWHERE),))
        self._plant = None
        if self._telemetry is not None:
            self._telemetry.phase = "greeting"
        return actions

    def _other_model(self, hello: PlantHello, *, gives_up: bool) -> Actions:
        """The two ends cannot work together."""
        notices = [self._refusal(f"plant {hello.instance} shares another model")]
        if gives_up:
            self.code = USAGE
            detail = (
                f"the plant's model is {hello.fingerprint[:8]}, "
                f"this controller's is {self.rules.fingerprint[:8]}"
            )
            if self._telemetry is not None:
                self._telemetry.phase, self._telemetry.detail = "refused", detail
            notices.append(Notice(f"{detail}: the two ends must share one scenario", "error"))
        return Actions(publish=(self._hello("other-model", hello),), notices=tuple(notices))

    def _remind(self) -> Actions:
        """Greet, but not too often."""
        if self.now < self.greeting_at:
            return NOTHING_TO_DO
        self.greeting_at = self.now + GREETING_S
        return Actions(publish=(self._greeting(),))

    def _greeting(self) -> ControllerHello:
        """Ask the plant to say which session it is in.

        The record must have been saved before: no other process may greet as this incarnation.
        """
        return self._hello("greeting")

    def _hello(
        self,
        verdict: Literal["greeting", "accepted", "unknown-session", "other-model"],
        hello: PlantHello | None = None,
    ) -> ControllerHello:
        return ControllerHello(
            instance=self.instance,
            incarnation=self.record.incarnation,
            fingerprint=self.rules.fingerprint,
            verdict=verdict,
            session=hello.session if hello else self.record.session,
            answers=hello.instance if hello else None,
        )

    def _refusal(self, text: str) -> Notice:
        if self._telemetry is not None:
            self._telemetry.detail = text
        return Notice(text, "warning", "refusals")

    def _malformed(self, text: str) -> Actions:
        self.malformed += 1
        return Actions(notices=(Notice(text, "warning", "malformed"),))

    # --- keys -------------------------------------------------------------------------------------

    def _stop_keys(self, command: StopKeys) -> Actions:
        """The claim that keys rest on is refuted: no more are made, and no offer has digits."""
        if self.record.refuted or not self.keys.on:
            return NOTHING_TO_DO
        self.record = self.record._replace(refuted=command.reason)
        self.keys.fail(command.reason)
        self._status_soon()
        notice = Notice(f"keys stop: {command.reason}", "error")
        return self._saved(Actions(notices=(notice,), durable=True))

    # --- commands ---------------------------------------------------------------------------------

    def _commanded(self, command: SendCommand) -> Actions:
        """The operator hands over a message; the same identifier is queued once."""
        size, queued = len(command.payload), self.messages.crc_of(command.id)
        waiting = self.messages.queued - self.record.message
        accepted, detail, actions = False, "", NOTHING_TO_DO
        if command.id == INITIAL_ID:
            detail = f"id: {INITIAL_ID!r} is the message that the controller is started with"
        elif size > MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected at most {MAX_PAYLOAD}"
        elif queued is None:
            actions, accepted = self._queue(command), True
            waiting += 1
        elif queued == crc32(command.payload):
            accepted, detail = True, "already queued"
        else:
            detail = f"id: {command.id!r} is another message's"
        reply = SendReply(id=command.id, accepted=accepted, queued=waiting, detail=detail)
        return actions._replace(publish=(reply,))

    def _queue(self, command: SendCommand) -> Actions:
        """Traced first: what is queued in the journal must not be missing from the trace.

        The record goes with it. The step under way was decided without this message: should it be
        counted again, then so too. On the disk before it is accepted.
        """
        return self._saved(Actions((command,), queued=command, durable=True))

    # --- the status -------------------------------------------------------------------------------

    def status(self) -> ControllerStatus:
        """What the dashboard is told; a controller without telemetry has none."""
        assert self._telemetry is not None
        return self._telemetry.status(
            self.record, self.rules, self.keys, self.messages, self.malformed
        )

    def _status(self) -> Actions:
        """A status to publish, and once in :data:`HEALTH_S` to be kept."""
        if self._telemetry is None:
            return NOTHING_TO_DO
        status = self.status()
        keep = self.now >= self._health_at
        if keep:
            self._health_at = self.now + HEALTH_S
        return Actions(publish=(status,), health=status if keep else None)

    def _status_soon(self) -> None:
        """Have a status published and kept at the next wake, which is then due at once."""
        if self._telemetry is not None:
            self._status_at = self._health_at = self.now


def _after(incarnation: int) -> int:
    return min(incarnation + 1, LARGEST_COUNT)
