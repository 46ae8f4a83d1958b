"""The plant's end of the link, sans I/O: what happens to a message, and when.

A step goes as in Fig. 5 of the paper, and in one order for every plant: an offer comes, it is
checked, the coin is tossed, the input is applied, the plant is read, what was read and what is said
are saved, the state is reported, and while the controller works on it the step is counted: both
ends judge it, advance the automaton, decrypt and take the symbol for a frame. Where a step acts on
something that cannot be put back, the coin is saved before the input is applied; a device is read
at the tick, and a model at once.

The rules are those of :mod:`protocol.link.session`. Which controller the session is with stands in
:mod:`protocol.link.plant_session`.
"""

from collections.abc import Callable
from math import inf
from typing import Literal

from pydantic import ValidationError

from plant_service.adapters.base import PlantError
from plant_service.plant import Coin, Plant
from plant_service.status import PlantTelemetry
from plant_service.watchdog import Farewell, Watchdog
from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import Distiller
from protocol.link.effects import Effects, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import (
    BLOCKS_DIFFER,
    FELL_BACK,
    NEW_JOURNAL,
    RESUMED,
    UNKNOWN_THERE,
    AttackBegan,
    Interrupted,
    Missed,
    PowerFailed,
    SessionBegan,
)
from protocol.link.incoming import Incoming, Taken
from protocol.link.key_events import appeared, block_notices, extraction_done
from protocol.link.pacing import Pacing, next_turn, phase_of
from protocol.link.plant_session import PlantSession, first_state
from protocol.link.records import Loaded, ReceiverRecord
from protocol.link.session import CountedTransition, Rules, Truth
from protocol.link.step import IDLE, Answered, Begun, Idle, Read
from protocol.messages import (
    ControllerHello,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantModel,
    PlantStatus,
)
from protocol.schemes.base import decrypt
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed
from protocol.secret.nonces import NonceSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import DONE, USAGE


class PlantCore:
    """The plant's end of one loop.

    Parameters
    ----------
    rules : Rules
    plant : Plant
        What is stepped.
    coin : Coin
    fallback : callable
        (x, u in force) to the input of a step without an offer.
    pacing : Pacing
    new_id : callable
        A random id for each session to begin.
    now : float
        The time.
    instance : str
        Random id of this process.
    loaded : Loaded
        As read back from the journal.
    first : ReceiverRecord, optional
        The record of a new session, where the journal has none.
    back : tuple of float, optional
        What a plant that acts has read first, where it is back with a journal; else None.
    steps : int, optional
        The last step: when k has come there the plant reports it, and is over.
    telemetry : PlantTelemetry, optional
        What is told beside the record; without it no status is published.
    watchdog_s : float, optional
        Seconds without an applied offer after which the plant goes to its safe state: counted from
        :meth:`start` on, so that a plant that was started again is watched while its controller is
        away. One that has never moved has :data:`plant_service.watchdog.MEETING_S` at least.
    attack : AttackBegan, optional
        What is traced of an attack on this plant.
    nonces : NonceSource
    round_trip_s : float
        Seconds within which the network brings an answer: the last word waits for so much more.

    Attributes
    ----------
    record : ReceiverRecord
        What came of all steps that are counted.
    step : Idle, Begun or Read
        The step after it.
    now, measured_at : float
        What time it was told last, and when step ``measured_k`` was measured first.
    session, frame, keys, pacing : PlantSession, Incoming, Distiller, Pacing
        The machines that it is made of, each with a state of its own.
    """

    hears: tuple[type[Message], ...] = (Offer, ControllerHello)
    says: tuple[type[Message], ...] = (Measurement, PlantHello, PlantModel, PlantStatus)

    def __init__(
        self,
        rules: Rules,
        plant: Plant,
        coin: Coin,
        fallback: Callable[[Vector, Vector], Vector],
        pacing: Pacing,
        new_id: Callable[[], str],
        now: float,
        *,
        instance: str,
        loaded: Loaded[ReceiverRecord],
        first: ReceiverRecord | None = None,
        back: Vector | None = None,
        steps: int | None = None,
        telemetry: PlantTelemetry | None = None,
        watchdog_s: float | None = None,
        attack: AttackBegan | None = None,
        nonces: NonceSource = fresh_nonce,
        round_trip_s: float = 0.0,
    ) -> None:
        record = loaded.record or first
        assert record is not None
        step = loaded.step
        assert not isinstance(step, Answered)
        self.rules, self.plant, self.coin = rules, plant, coin
        self.instance = instance
        self.code: int | None = None
        self.malformed = 0
        self.now = self.measured_at = now
        self.measured_k = self._latest_late_k = -1
        self.pacing = pacing
        self.step: Idle | Begun | Read = step
        self.session = PlantSession(instance, rules.fingerprint, record, now)
        self.frame = Incoming(rules.size, loaded.symbols + record.partial)
        self.keys = Distiller(rules.schedule, rules.size, nonces)
        said = step.report if isinstance(step, Read) else record
        self.keys.begin(
            record.session, said.block, said.tag, record.confirmed, loaded.rows, loaded.held
        )
        self.record = record._replace(
            state=rules.scheme.restore(record.state),
            tag=record.tag or self.keys.no_tag,
        )
        self._fallback, self._new_id = fallback, new_id
        self._steps = steps
        self._left = True  # copy 0 of the newest measurement may have left
        self._fresh, self._fell_back = loaded.record is None, loaded.fell_back
        self._back, self._attack = back, attack
        self._watchdog = Watchdog(watchdog_s)
        self._farewell = Farewell(round_trip_s)
        self._telemetry = telemetry
        self._status_at = inf if telemetry is None else now

    @property
    def under_way(self) -> Offer | None:
        """The offer whose step is not counted yet, if any."""
        return None if isinstance(self.step, Idle) else self.step.offer

    @property
    def accepted(self) -> bool:
        """Whether the controller asked has accepted this session since this process began."""
        return self.session.accepted

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""
        return self.keys.on

    @property
    def refused(self) -> bool:
        """Whether the only controller shares another model: there is nothing to go on with."""
        return self.session.state == "refused"

    @property
    def _moved(self) -> bool:
        """Whether the plant was ever moved, or a step of its was missed."""
        return self.record.k > 0 or self.step is not IDLE

    @property
    def _running(self) -> bool:
        """Whether ticks count: only once the plant has moved or a controller has accepted it."""
        return self._moved or self.accepted

    @property
    def _finished(self) -> bool:
        return self._steps is not None and self.record.k >= self._steps

    # --- what the shell calls ---------------------------------------------------------------------

    def start(self, now: float) -> Effects:
        """Say which session this is; a step that the journal holds is counted now.

        The step in which the process of a plant that acts died is missed. Where the newest steps
        may be lost a new session begins: the controller may have lost as many, and neither could
        tell.
        """
        self.now = now
        self._watchdog.begin(now, moved=self._moved)
        if self._fell_back:
            yield Tell(PowerFailed())
        reason = NEW_JOURNAL if self._fresh else RESUMED
        yield Tell(SessionBegan(self.record.session, reason))
        if self._attack is not None:
            yield Tell(self._attack)
        if self._fresh:
            yield self._save()
        yield from map(Extract, self.keys.tasks())
        if isinstance(self.step, Read):
            yield from self._count(self.step)
        if self._back is not None:
            yield Tell(self._interrupted(self._back))
            yield self._save()
        if self._fell_back:
            self._begin_session()
            self.session.state = first_state(self.record)
            yield from self._anew(FELL_BACK, f"{FELL_BACK}; new session", "warning")

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Effects:
        """An offer, or a hello of the controller."""
        self.now = now
        if not self._running:
            self.pacing.tick(now, running=False)
        try:  # what is received, and that alone: a wrong message of this end's own is a fault in it
            if kind is Offer:
                return self._offered(Offer.from_wire(payload))
            if kind is ControllerHello:
                return self._heard_hello(ControllerHello.model_validate_json(payload))
        except ValidationError as error:
            what = "offer" if kind is Offer else "hello"
            return self._malformed(f"{what}: {error.error_count()} fields not as expected; ignored")
        raise TypeError(f"{kind.__name__}: expected one of {self.hears}")

    def wake_at(self) -> float:
        """The earliest of tick, repeat, hello, silence, status and watchdog."""
        if self.refused:
            return -inf
        if self._finished:
            return self._farewell.due_at
        accepted, pacing = self.accepted, self.pacing
        return min(
            self._status_at,
            self._watchdog.at,
            pacing.due_at(running=self._moved or accepted, measuring=accepted),
            self.session.due_at(waiting=pacing.waiting),
        )

    def wake(self, now: float) -> Effects:
        """A tick, a repeated measurement, a hello, a status: whatever is due."""
        self.now = now
        if self.refused:
            self.code = USAGE
            return
        if self._finished:  # the last transition is reported until it is counted
            if self._farewell.over(now):
                self.code = DONE
            else:
                yield Publish(self._measurement())
            return
        if now >= self._watchdog.at:
            patience = self._watchdog.patience_s(moved=self._moved)
            why = f"the watchdog: no offer was applied for {patience:g} s"
            self.plant.safe(why)
            raise PlantError(why)
        pacing, session = self.pacing, self.session
        if pacing.waiting:
            session.answered_at = now
        if session.hello_due(now):
            yield Publish(session.hello(self.record))
        over = pacing.tick(now, running=self._running)
        if over != "nothing" and self._telemetry is not None:
            self._telemetry.punctuality.ticked(pacing.late_s, pacing.overruns)
        if over == "missed":
            yield from self._miss()
        elif over == "ended" and isinstance(self.step, Begun):
            yield from self._read(self.step)
        if self.accepted and pacing.measurement_due(now):
            if self.record.k != self.measured_k:
                self.measured_k, self.measured_at = self.record.k, now
            yield Publish(self._measurement())
        if self._telemetry is not None and now >= self._status_at:
            self._status_at = next_turn(now, self._telemetry.status_s, phase_of(self.instance))
            yield from self._status()

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Effects:
        """A key block is extracted, or none can be any more."""
        return extraction_done(self.keys, block)

    def appear(self, count: int) -> Effects:
        """From now on a message leaves ``count`` times."""
        return appeared(self.keys, self.record.session, self.record.k, count)

    def stop(self, now: float) -> Effects:
        """The last status. The plant goes to its safe state and is closed."""
        self.now = now
        self._report_stopped()
        self.plant.safe("the process ended")
        failed = self.plant.close()
        self._status_soon()
        if self._telemetry is not None:
            timing = self._telemetry.punctuality.as_event(self.record.k)
            if timing is not None:
                yield Tell(timing)
        if self.step is IDLE:  # digits that have served are erased now, and else with the next step
            yield self._save()
        yield from self._status()
        if failed:
            yield Notice(failed, "error")

    # --- a step: offer, check, coin, begin --------------------------------------------------------

    def _offered(self, offer: Offer) -> Effects:
        """If the offer is for this step: toss the coin, and begin."""
        record, now = self.record, self.now
        if self._finished:  # all that matters now is that the last step was counted
            if offer.k == record.k:  # the controller has counted the last step
                self.code = DONE
            return
        try:
            what = self._check(offer)
        except ValueError as error:
            yield from self._malformed(f"{error}; ignored")
            return
        if what != "foreign":
            self.session.answered_at = now
        if what == "stale" and max(record.applied_k, self._latest_late_k) < offer.k < record.k:
            # Its step was missed. (An answer to a repeated measurement, whose step was made, is
            # not late; nor is it late twice.)
            self._latest_late_k = offer.k
            self.pacing.answered_late()
            if self._telemetry is not None:
                self._telemetry.late += 1
        if what != "current" or self.pacing.waiting:
            return
        if self.measured_k == record.k and self._telemetry is not None:
            self._telemetry.answered(now - self.measured_at)
        self.keys.heard(offer)  # first: it may confirm the block of the offer's digits
        digits = self._digits(offer)
        if self.keys.on and not digits and self.keys.awaits(offer.position.block):
            return  # the offer comes again, when its digits are there
        keyed = self.rules.keyed and digits
        coin = digits[0] if keyed else self.coin.toss(record.transitions)
        self.step = step = Begun(offer, coin)
        if self.plant.acts:  # that cannot be undone
            yield self._save()
        self.plant.begin(record.k, record.x, offer.candidates[coin])
        if self._telemetry is not None and self.pacing.timed:
            self._telemetry.punctuality.acted(self.pacing.since_tick_s(now))
        self.pacing.applied()
        self._watchdog.applied(now)
        if not (self.plant.acts and self.pacing.waiting):
            yield from self._read(step)

    def _check(self, offer: Offer) -> Literal["current", "stale", "foreign"]:
        """Whether an offer is for this session and this step (rule 5).

        Raises
        ------
        ValueError
            When its shape is not the plant's, or a candidate is not admissible: malformed.
        """
        rules = self.rules
        if len(offer.candidates) != rules.size:
            raise ValueError(
                f"offer.candidates: got {len(offer.candidates)}, expected {rules.size}"
            )
        if any(len(u) != rules.inputs for u in offer.candidates):
            raise ValueError(f"offer.candidates: expected {rules.inputs} inputs in each")
        if not all(map(rules.admissible, offer.candidates)):
            raise ValueError("offer.candidates: expected inputs in U")
        if wrong := rules.malformed_predictions(offer.predictions):
            raise ValueError(wrong)
        if wrong := rules.malformed_digits(
            "offer.stream_block", offer.stream_block, offer.stream_at
        ):
            raise ValueError(wrong)
        if offer.cipher >= rules.size:
            raise ValueError(f"offer.cipher: got {offer.cipher}, expected below {rules.size}")
        if offer.session != self.record.session:
            return "foreign"
        return "current" if offer.k == self.record.k else "stale"

    def _digits(self, offer: Offer) -> tuple[int, ...]:
        """The digits of the key stream that an offer names, where this end holds them."""
        count = self.rules.digits
        return (count and self.keys.stream.at(offer.position, count)) or ()

    # --- read, save, report -----------------------------------------------------------------------

    def _read(self, step: Begun) -> Effects:
        """The step is over: read the plant, save what is said of it, report it, and count it.

        A step whose session has ended while the plant acted counts in neither, and is missed.
        """
        offer, record = step.offer, self.record
        x_next = self.plant.end(record.k)
        if offer.session != record.session:
            yield Tell(self._interrupted(x_next, sure=True))
            yield self._save()
            return
        digits = self._digits(offer)
        report = self._report(offer, x_next, keyed=bool(digits))
        self.step = read = Read(offer, step.coin, report)
        due = self.accepted and self.pacing.measurement_due(self.now)
        if due:
            self._left = True
            self.measured_k, self.measured_at = record.k + 1, self.now
        # By a frame's last report the controller takes the message for delivered.
        scheme = self.rules.scheme
        carried = bool(digits) if scheme.from_stream else scheme.pad(record.state) >= 0
        yield self._save(durable=self.frame.lacks_one and carried)
        if due:
            yield Publish(report)
        yield from self._count(read)

    def _save(
        self, symbols: str = "", received: bytes | None = None, *, durable: bool = False
    ) -> Save:
        """The record and the step as they are now, with all that belongs to them."""
        if self.record.confirmed != self.keys.confirmed:
            self.record = self.record._replace(confirmed=self.keys.confirmed)
        rows = self.keys.rows()
        return Save(self.record, self.step, rows, symbols, None, received, durable)

    def _report(self, offer: Offer, x_next: Vector, *, keyed: bool) -> Measurement:
        """Measurement(k + 1), once ``offer`` has been applied: its copy 0."""
        record = self.record
        block, tag = self.keys.announcement()
        self._left = False
        return Measurement(
            session=record.session,
            k=record.k + 1,
            x=x_next,
            applied_k=record.k,
            x_after=x_next,
            copy_number=self.keys.copy(),
            nonce=self.keys.nonce(),
            applied_copy=offer.copy_number,
            block=block,
            tag=tag,
            keyed=keyed if self.rules.digits else None,
        )

    def _measurement(self) -> Measurement:
        """Measurement(k): the state, the last applied offer and what came right after it.

        The first one of a step is its copy 0 and must leave; each one after it is another copy.
        """
        record = self.record
        again = (self._left or bool(self.keys.crowded)) and self.keys.on
        self._left = True
        return Measurement(
            session=record.session,
            k=record.k,
            x=record.x,
            applied_k=record.applied_k,
            x_after=record.x_after,
            copy_number=1 if again else 0,
            nonce=self.keys.nonce() if again else record.nonce,
            applied_copy=record.applied_copy,
            block=record.block,
            tag=record.tag,
            keyed=record.keyed if self.rules.digits else None,
        )

    # --- count: judge, advance the automaton, decrypt, deframe ------------------------------------

    def _count(self, step: Read) -> Effects:
        """Count the transition that the step made.

        The key is what the test returns, as for the controller; the coin is only compared with it.
        """
        record, rules = self.record, self.rules
        offer, coin, report = step
        u, x_next = offer.candidates[coin], report.x
        counted = rules.count(record, offer, x_next, self._digits(offer) if report.keyed else ())
        agreed, pad = counted.carry
        symbol, taken = NO_SYMBOL, Taken(record.partial, record.stored)
        if pad != NO_SYMBOL:
            symbol = decrypt(offer.cipher, pad, rules.size)
            taken = self.frame.take(symbol, record.partial, record.stored)
        contribution = self.keys.count(
            record.transitions,
            record.k - record.applied_k,
            offer,
            offer.copy_number,
            record.nonce,
        )
        truth = self.plant.truth
        transition = CountedTransition.of(
            rules.scheme,
            record,
            offer,
            x_next,
            counted,
            symbol,
            contribution,
            coin,
            u,
            truth,
            recovered=taken.payload,
            refused=taken.refused,
        )
        self.step = IDLE
        self.record = record._replace(
            k=record.k + 1,
            x=x_next,
            u=u,
            applied_k=record.k,
            x_after=x_next,
            partial=taken.partial,
            stored=taken.stored,
            state=counted.state,
            transitions=record.transitions + 1,
            p=transition.p,
            agreements=record.agreements + (agreed != NO_SYMBOL),
            symbol_errors=record.symbol_errors + (agreed not in (NO_SYMBOL, coin)),
            messages=record.messages + (taken.payload is not None),
            frames_refused=record.frames_refused + taken.refused,
            nonce=report.nonce,
            applied_copy=report.applied_copy,
            block=report.block,
            tag=report.tag,
            blocks_begun=record.blocks_begun + (contribution is not None and self.keys.began),
            keyed=bool(report.keyed),
            estimate=counted.verdict.estimate,
            true_x=self._state_of(truth),
        )
        self.session.on("offer applied")
        if counted.digits:
            self.keys.used(offer.position, rules.digits)
        self.coin.prepare(self.record.transitions)
        self.plant.prepare(self.record.k)
        contradicted = None if self._telemetry is None else self._telemetry.counted(transition)
        ended = self.keys.ended()
        for block in ended:
            yield Tell(block)
        yield Tell(transition)
        if taken.symbols or taken.ended:  # else the next step saves the record
            yield self._save(taken.symbols, taken.payload)
        if self.keys.on:
            yield from map(Extract, self.keys.tasks())
        if taken.ended:
            yield self._frame_ended(transition)
        if contradicted is not None:
            yield Notice(contradicted, "warning")
        if ended:
            yield from block_notices(self.keys, ended)
        if any(block.what == "unequal" for block in ended):
            self.session.on("blocks differ")
            self._begin_session()
            yield from self._anew(BLOCKS_DIFFER, f"{BLOCKS_DIFFER}; new session", "error")

    def _frame_ended(self, transition: CountedTransition) -> Notice:
        """What is told of a frame that is whole, or failed its check."""
        payload, k = transition.recovered, transition.k
        if payload is None:
            return Notice("a frame failed its check and was refused", "error")
        if self._telemetry is not None:
            self._telemetry.last_message, self._telemetry.message_k = payload, k
        if self._finished:
            self._report_stopped()
        self._status_soon()
        return Notice(f"message recovered at step {k}: {len(payload)} bytes")

    # --- steps without an offer -------------------------------------------------------------------

    def _miss(self) -> Effects:
        """No offer came in time (rule 4).

        A model makes the step under the fallback. A device has already made it, under the input in
        force; the fallback is applied for the step to come.
        """
        record, moved = self.record, self._moved
        u = record.u
        if not self.plant.device:
            u = self._instead()
            self.plant.begin(record.k, record.x, u)
        x_next = self.plant.end(record.k)
        self._missed(u, x_next)
        self._fall_back(sure=True)
        if not moved:
            self._watchdog.moves(self.now)
        yield Tell(Missed(record.session, record.k, record.x, u, x_next, self.plant.truth))
        yield self._save()

    def _instead(self) -> Vector:
        """The fallback's input for this step."""
        record, outputs = self.record, self.rules.outputs
        if outputs is None:
            return self._fallback(record.x, record.u)
        return outputs.instead(record.estimate, record.k - record.applied_k - 1, record.u)

    def _state_of(self, truth: Truth | None) -> Vector:
        """The simulated state that the record keeps: where no reading tells it."""
        return () if self.rules.outputs is None or truth is None else truth.x_next

    def _missed(self, u: Vector, x_next: Vector) -> None:
        """Count a step without a transition, with ``u`` in force."""
        record = self.record
        block, tag = self.keys.announcement()
        self.step = IDLE
        self.record = record._replace(
            k=record.k + 1,
            x=x_next,
            u=u,
            missed=record.missed + 1,
            nonce=self.keys.nonce(),
            block=block,
            tag=tag,
            true_x=self._state_of(self.plant.truth),
        )
        self._left = False

    def _fall_back(self, *, sure: bool) -> None:
        """Apply a device's fallback for the step to come, where it may not be in force already."""
        record = self.record
        if not self.plant.device:
            return
        following = self._fallback(record.x, record.u)
        if not sure or following != record.u:
            self.plant.begin(record.k, record.x, following)
            self.record = record._replace(u=following)

    def _interrupted(self, x_next: Vector, *, sure: bool = False) -> Interrupted:
        """Count the step under way, which ends at ``x_next``, as a missed one.

        Parameters
        ----------
        x_next : tuple of float, shape (n,)
        sure : bool
            Whether the input chosen was applied; nobody knows after a death.
        """
        record, step = self.record, self.step
        candidates: tuple[Vector, ...] = ()
        u, coin = record.u, NO_SYMBOL
        if isinstance(step, Begun):
            candidates, coin = step.offer.candidates, step.coin
            u = candidates[coin]
        self._missed(u, x_next)
        self._fall_back(sure=sure or not candidates)
        truth = self.plant.truth
        return Interrupted(record.session, record.k, record.x, u, x_next, candidates, coin, truth)

    # --- sessions ---------------------------------------------------------------------------------

    def _heard_hello(self, hello: ControllerHello) -> Effects:
        """The controller spoke on the management bus: do as the table says."""
        if self._finished:
            return
        session = self.session
        answer = session.hears(hello, self.record, self.now)
        if answer in ("ask", "begin and ask"):
            self.record = self.record._replace(
                controller=hello.instance, incarnation=hello.incarnation
            )
        who = f"controller {hello.instance}"
        match answer:
            case "ask":
                yield self._save()
                yield Publish(session.hello(self.record))
            case "begin anew" | "begin and ask":
                self._begin_session()
                yield from self._anew(UNKNOWN_THERE, "session ended; new session", "warning")
            case "work":
                self._set_phase("running")
                if session.took_up(self.record.session):
                    yield Notice(f"{who} took up session {self.record.session}")
            case "say whose":
                text = f"speaks up while controller {session.controller} has the session: "
                yield Publish(session.hello(self.record))
                yield _incompatible(f"{who} {text}two controllers on one loop?")
            case "say model":
                if hello.verdict == "greeting":
                    yield Publish(session.hello(self.record))
                yield _incompatible(f"{who} has another model, {hello.fingerprint[:8]}; ignored")
            case "give up":
                detail = (
                    f"the controller's model is {hello.fingerprint[:8]}, "
                    f"this plant's is {self.rules.fingerprint[:8]}"
                )
                self._set_phase("refused", detail)
                yield Notice(f"{detail}: the two ends must share one scenario", "error")

    def _begin_session(self) -> None:
        """A new session: all that was agreed or half received in the one before is dropped."""
        session = self._new_id()
        self.frame.reset()
        self.record = self.record._replace(
            session=session,
            applied_k=-1,
            x_after=(),
            partial="",
            stored=0,
            state=self.rules.scheme.initial,
            transitions=0,
            p=0,
            sessions=self.record.sessions + 1,
            nonce="",  # that of this step may have left
            applied_copy=0,
            block=-1,
            tag=self.keys.no_tag,
            confirmed=-1,
            keyed=False,
            estimate=None,
        )
        self._left = True
        self.keys.begin(session)

    def _anew(self, why: str, notice: str, level: Literal["warning", "error"]) -> Effects:
        """Tell of a new session, save it, and say hello."""
        self._set_phase("greeting")
        session = self.record.session
        yield Tell(SessionBegan(session, why))
        yield self._save()
        yield Publish(self.session.hello(self.record))
        yield Notice(f"{notice} {session}", level)

    def _malformed(self, text: str) -> Effects:
        self.malformed += 1
        return (Notice(text, "warning", "malformed"),)

    # --- the status -------------------------------------------------------------------------------

    def status(self, now: float, *, whole: bool = True) -> PlantStatus:
        """What the dashboard is told; a plant without telemetry has none."""
        assert self._telemetry is not None
        return self._telemetry.status(
            self.record, self.frame.deframer, self.keys, self.malformed, now, whole=whole
        )

    def _status(self) -> Effects:
        """A status to publish, its model before it where that is due, and to keep once a second."""
        telemetry = self._telemetry
        if telemetry is None:
            return
        whole = telemetry.model_is_due()
        status = self.status(self.now, whole=whole)
        if whole:  # who hears this one lacks nothing
            yield Publish(telemetry.model)
        yield Publish(status)
        if telemetry.health_is_due(self.now):
            yield Show(status)

    def _status_soon(self) -> None:
        """Have a status published and kept at the next wake, which is then due at once."""
        if self._telemetry is not None:
            self._status_at = self._telemetry.health_at = self.now

    def _set_phase(
        self, phase: Literal["greeting", "running", "refused"], detail: str = ""
    ) -> None:
        """Set the status's phase and detail."""
        if self._telemetry is not None:
            self._telemetry.phase = phase
            self._telemetry.detail = detail or self._telemetry.detail

    def _report_stopped(self) -> None:
        """Set the status's phase to stopped, unless the plant was refused."""
        if self._telemetry is not None and self._telemetry.phase != "refused":
            self._telemetry.phase = "stopped"


def _incompatible(text: str) -> Notice:
    return Notice(text, "warning", "incompatible")
