"""The plant's end of the link, sans I/O: one room for its steps, its session, its timers.

A step goes as in Fig. 5 of the paper, and in one order for every plant: an offer comes, it is
checked, the coin is tossed, the input is applied (:meth:`PlantCore._begin`), the plant is read,
what it was and what is said are saved, the state is reported (:meth:`PlantCore._end`), and while
the controller works on it the step is counted (:meth:`PlantCore._count`): both ends judge it,
advance the automaton, decrypt and take the symbol for a frame. Where a step acts on something that
cannot be put back, the coin is saved before the input is applied.

The rules are those of :mod:`protocol.link.session`. Which controller the session is with stands in
:mod:`protocol.link.plant_session`.
"""

from collections.abc import Callable, Iterable
from math import inf
from typing import Final, Literal

from pydantic import ValidationError

from plant_service.adapters.base import PlantError
from plant_service.plant import Coin, Plant
from plant_service.status import PlantTelemetry
from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import NO_ROWS, Distiller
from protocol.link.events import (
    BLOCKS_DIFFER,
    FELL_BACK,
    NEW_JOURNAL,
    RESUMED,
    UNKNOWN_THERE,
    AttackBegan,
    Interrupted,
    Missed,
    SessionBegan,
)
from protocol.link.key_events import appeared, block_notices, extraction_done
from protocol.link.pacing import LOCKSTEP_REPEAT_S, Pacing, next_turn, phase_of
from protocol.link.peer import NOTHING_TO_DO, Actions, Notice
from protocol.link.plant_session import TABLE, TO_ANYONE, WORKING, Heard, State, first_state, heard
from protocol.link.records import ReceiverRecord
from protocol.link.session import SILENCE_S, CountedTransition, Rules, Truth
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
from protocol.schemes.framing import Deframer
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed
from protocol.secret.nonces import Contribution, NonceSource
from protocol.secret.stream import Part
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import DONE, USAGE

HELLO_S: Final = 0.1
"""Seconds between hellos until the controller answers."""

MEETING_S: Final = 10.0
"""Least seconds before the watchdog of a plant that has never moved: its controller is still
starting."""

FAREWELL_S: Final = 1.0
"""Seconds to wait at the end for the controller to count the last transition."""

SYMBOLS_AT_ONCE: Final = 64
"""Symbols of the frame under way that the record holds; then they go to a table of the journal.
A frame may have half a million symbols, and the record is written in every step."""


def hex_digits(size: int) -> int:
    """Hexadecimal digits of a symbol in the record: one up to M = 16, else two."""
    return 1 if size <= 16 else 2


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
    record : ReceiverRecord
        As read back from the journal, or a new session's.
    symbols : str
        Those of the frame under way that have left the record, as read back.
    contributions : iterable of Contribution
        Rows of key blocks that may still be needed, as read back.
    parts : iterable of Part
        Digits of the key stream that are left, as read back.
    offer, tossed, report : optional
        The journal's step: its offer, b_r and the measurement that reports it. It was not counted,
        or, where there is no report, begun and not read.
    back : tuple of float, optional
        What a plant that acts has read first, where it is back with a journal; else None.
    fresh : bool
        The record is a new one, and in no journal yet.
    fell_back : bool
        The journal may lack its newest steps: a new session begins.
    steps : int, optional
        The last step: when k has come there the plant reports it, and is over.
    telemetry : PlantTelemetry, optional
        What is told beside the record; without it no status is published.
    watchdog_s : float, optional
        Seconds without an applied offer after which the plant goes to its safe state: counted from
        :meth:`start` on, so that a plant that was started again is watched while its controller is
        away. One that has never moved has :data:`MEETING_S` at least to meet it.
    attack : AttackBegan, optional
        What is traced of an attack on this plant.
    nonces : NonceSource
    round_trip_s : float
        Seconds within which the network brings an answer: the last word waits for so much more.

    Attributes
    ----------
    now, answered_at, hello_at, measured_at : float
        The timers, in seconds: what it was told last, when the controller was heard, when a hello
        is due, when step ``measured_k`` was measured first. They move together with the clock.
    pacing : Pacing
    state : State
        How it stands with its controller.
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
        record: ReceiverRecord,
        symbols: str = "",
        contributions: Iterable[Contribution] = (),
        parts: Iterable[Part] = (),
        offer: Offer | None = None,
        tossed: int = NO_SYMBOL,
        report: Measurement | None = None,
        back: Vector | None = None,
        fresh: bool = False,
        fell_back: bool = False,
        steps: int | None = None,
        telemetry: PlantTelemetry | None = None,
        watchdog_s: float | None = None,
        attack: AttackBegan | None = None,
        nonces: NonceSource = fresh_nonce,
        round_trip_s: float = 0.0,
    ) -> None:
        self.rules = rules
        self.plant = plant
        self.instance = instance
        self.code: int | None = None
        self.malformed = 0
        self.pacing = pacing
        self._new_id = new_id
        self.now = now
        self._fresh = fresh
        self._fell_back = fell_back
        self._attack = () if attack is None else (attack,)
        # the step
        self.coin = coin
        self._fallback = fallback
        self._steps = steps
        self._offer = offer  # which it takes, from its coin until it is counted
        self._tossed = tossed  # its b_r
        self._said = report  # of its end, once that was read
        self._taken: tuple[int, ...] = ()  # digits of the key stream
        self._truth: Truth | None = None if offer is None else plant.truth  # of its end
        self._back = back
        self._moved = record.k > 0 or offer is not None
        self._left = True  # copy 0 of the newest measurement may have left
        self._latest_late_k = self.measured_k = -1
        self.measured_at = now
        # the frame under way
        self.deframer = Deframer(rules.size)
        self._digits = hex_digits(rules.size)
        kept = symbols + record.partial
        for i in range(0, len(kept), self._digits):
            self.deframer.push(int(kept[i : i + self._digits], 16))
        self._last_symbol = self.deframer.lacks_one  # known before a step hangs on it
        # keys
        self.keys = Distiller(rules.schedule, rules.size, nonces)
        said = report or record
        self.keys.begin(
            record.session, said.block, said.tag, record.confirmed, contributions, parts
        )
        if offer is not None and report is not None and report.keyed:
            self._taken = self.keys.stream.at(offer.position, rules.digits) or ()
        # the session
        self.record = record._replace(
            state=rules.scheme.restore(record.state),
            tag=record.tag or self.keys.no_tag,
        )
        self.controller: str | None = None
        """The controller process that this process asked last, if any."""
        self.state: State = first_state(record)
        self._met = record.transitions > 0 or record.sessions > 1
        self._taken_up = ("", "")
        self.hello_at = -inf
        self.answered_at = now
        # timers of its own
        self._watchdog_s = inf if watchdog_s is None else watchdog_s
        self._watchdog_at = inf
        self._telemetry = telemetry
        self._status_at = inf if telemetry is None else now
        # the end
        self._last_at = -inf
        self._gives_up_at: float | None = None
        self._farewell_s = FAREWELL_S + round_trip_s

    @property
    def under_way(self) -> Offer | None:
        """The offer whose step is not counted yet, if any."""
        return self._offer

    @property
    def accepted(self) -> bool:
        """Whether the controller asked has accepted this session since this process began."""
        return self.state in WORKING

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""
        return self.keys.on

    @property
    def refused(self) -> bool:
        """Whether the only controller shares another model: there is nothing to go on with."""
        return self.state == "refused"

    @property
    def _running(self) -> bool:
        """Whether ticks count: only once the plant has moved or a controller has accepted it."""
        return self._moved or self.accepted

    @property
    def _finished(self) -> bool:
        return self._steps is not None and self.record.k >= self._steps

    # --- what the shell calls ---------------------------------------------------------------------

    def start(self, now: float) -> Actions:
        """Say which session this is; a step that the journal holds is counted now.

        The step that was under way when a plant's process died is missed.
        """
        self.now = now
        self._watchdog_at = now + self._patience_s
        record = self.record
        reason = NEW_JOURNAL if self._fresh else RESUMED
        actions = Actions(
            events=(SessionBegan(record.session, reason), *self._attack),
            tasks=self.keys.tasks(),
            finish_step=self._said is not None,
        )
        if self._fresh:
            actions = self._saved(actions)
        return actions if actions.finish_step else self._came_back(actions)

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """An offer, or a hello or announcement of the controller."""
        self.now = now
        if not self._running:
            self.pacing.tick(now, running=False)
        try:  # what is received, and that alone: a wrong message of this end's own is a fault in it
            message = (
                Offer.from_wire(payload) if kind is Offer else kind.model_validate_json(payload)
            )
        except ValidationError as error:
            what = "offer" if kind is Offer else "hello"
            return self._malformed(f"{what}: {error.error_count()} fields not as expected; ignored")
        match message:
            case Offer():
                return self._offered(message)
            case ControllerHello():
                return self._heard_hello(message)
        raise TypeError(f"{kind.__name__}: expected one of {self.hears}")

    def wake_at(self) -> float:
        """The earliest of tick, repeat, hello, silence, status and watchdog."""
        if self.refused:
            return -inf
        if self._finished:
            return self._last_at
        accepted, pacing = self.accepted, self.pacing
        due = min(
            self._status_at,
            self._watchdog_at,
            pacing.due_at(running=self._moved or accepted, measuring=accepted),
        )
        if not accepted:
            return min(due, self.hello_at)
        if pacing.waiting:
            return due
        return min(due, max(self.hello_at, self.answered_at + SILENCE_S))

    def wake(self, now: float) -> Actions:
        """A tick, a repeated measurement, a hello, a status: whatever is due."""
        self.now = now
        pacing = self.pacing
        if self.refused:
            self.code = USAGE
            return NOTHING_TO_DO
        if self._finished:
            return self._farewell()
        if now >= self._watchdog_at:
            why = f"the watchdog: no offer was applied for {self._patience_s:g} s"
            self.plant.safe(why)
            raise PlantError(why)
        if pacing.waiting:
            self.answered_at = now
        publish: list[Message] = []
        silent = now >= self.answered_at + SILENCE_S  # as in wake_at, to the last bit
        if silent:
            self.state = TABLE[self.state, "silence"].next
        if (silent or not self.accepted) and now >= self.hello_at:
            self.hello_at = now + HELLO_S
            publish.append(self._hello())
        actions = NOTHING_TO_DO
        over = pacing.tick(now, running=self._running)
        if over != "nothing" and self._telemetry is not None:
            self._telemetry.punctuality.ticked(pacing.late_s, pacing.overruns)
        if over == "missed":
            actions = self._miss()
        elif over == "ended" and self._offer is not None:
            actions = self._end()
        status = NOTHING_TO_DO
        if self._telemetry is not None and now >= self._status_at:
            self._status_at = next_turn(now, self._telemetry.status_s, phase_of(self.instance))
            status = self._status()
            publish += status.publish
        if self.accepted and not actions.finish_step and pacing.measurement_due(now):
            if self.record.k != self.measured_k:
                self.measured_k, self.measured_at = self.record.k, now
            publish.append(self._measurement())
        return actions._replace(publish=(*actions.publish, *publish), health=status.health)

    def finish_step(self) -> Actions:
        """Go on with the step that was saved: begin it where it acts, or else count it."""
        if self._said is not None:
            return self._came_back(self._count())
        self._apply()
        return NOTHING_TO_DO if self.pacing.waiting else self._end()

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Actions:
        """A key block is extracted, or none can be any more."""
        return extraction_done(self.keys, block)

    def appear(self, count: int) -> Actions:
        """From now on a message leaves ``count`` times."""
        return appeared(self.keys, self.record.session, self.record.k, count)

    def stop(self, now: float) -> Actions:
        """The last status. The plant goes to its safe state and is closed."""
        self.now = now
        self._report_stopped()
        self.plant.safe("the process ended")
        failed = self.plant.close()
        self._status_soon()
        timing = None
        if self._telemetry is not None:
            timing = self._telemetry.punctuality.as_event(self.record.k)
        actions = self._status()._replace(
            events=() if timing is None else (timing,),
            notices=(Notice(failed, "error"),) if failed else (),
        )
        # between steps the digits that have served are erased now, and else with the next step
        return self._saved(actions) if self._offer is None else actions

    # --- a step: offer, check, coin, begin --------------------------------------------------------

    def _offered(self, offer: Offer) -> Actions:
        """If the offer is for this step: toss the coin, and begin."""
        record, now = self.record, self.now
        if self._finished:  # all that matters now is that the last step was counted
            if offer.k == record.k:  # the controller has counted the last step
                self.code = DONE
            return NOTHING_TO_DO
        try:
            what = self._check(offer)
        except ValueError as error:
            return self._malformed(f"{error}; ignored")
        if what != "foreign":
            self.answered_at = now
        if what == "stale" and max(record.applied_k, self._latest_late_k) < offer.k < record.k:
            # Its step was missed. (An answer to a repeated measurement, whose step was made, is
            # not late; nor is it late twice.)
            self._latest_late_k = offer.k
            self.pacing.answered_late()
            if self._telemetry is not None:
                self._telemetry.late += 1
        if what != "current" or self.pacing.waiting:
            return NOTHING_TO_DO
        if self.measured_k == record.k and self._telemetry is not None:
            self._telemetry.answered(now - self.measured_at)
        self.keys.heard(offer)  # first: it may confirm the block of the offer's digits
        self._taken = self.keys.stream.at(offer.position, self.rules.digits) or ()
        if not self._taken and self.keys.awaits(offer.position.block):
            return NOTHING_TO_DO  # the offer comes again, when its digits are there
        if self.rules.keyed and self._taken:
            return self._begin(offer, self._taken[0])
        return self._begin(offer, self.coin.toss(record.transitions))

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

    def _begin(self, offer: Offer, tossed: int) -> Actions:
        """Apply the input that the coin chose; where that cannot be undone, save the coin first."""
        self._offer, self._tossed = offer, tossed
        self._moved = True
        if self.plant.acts:
            return self._saved(Actions(offer=offer, coin=tossed, finish_step=True))
        self._apply()
        return self._end()

    def _apply(self) -> None:
        assert self._offer is not None
        self.plant.begin(self.record.k, self.record.x, self._offer.candidates[self._tossed])
        if self._telemetry is not None and self.pacing.timed:
            self._telemetry.punctuality.acted(self.pacing.since_tick_s(self.now))
        self.pacing.applied()
        self._watchdog_at = self.now + self._watchdog_s

    # --- end: read, save, report ------------------------------------------------------------------

    def _end(self) -> Actions:
        """The step is over: read the plant, save what is said of it, and report.

        A step whose session has ended while the plant acted counts in neither, and is missed.
        """
        offer, record = self._offer, self.record
        assert offer is not None
        x_next = self.plant.end(record.k)
        if offer.session != record.session:
            return self._saved(Actions((self._interrupted(x_next, sure=True),)))
        self._truth = self.plant.truth
        self._said = report = self._report(offer, x_next)
        due = self.accepted and self.pacing.measurement_due(self.now)
        if due:
            self._left = True
            self.measured_k, self.measured_at = record.k + 1, self.now
        step = Actions(
            offer=offer,
            coin=self._tossed,
            measurement=report,
            durable=self._ends_a_frame(),
            publish=(report,) if due else (),
            finish_step=True,
        )
        return self._saved(step)

    def _ends_a_frame(self) -> bool:
        """Whether the step under way brings the last symbol of a frame.

        By its report the controller takes the message for delivered, so it must be on the disk.
        """
        scheme = self.rules.scheme
        carried = bool(self._taken) if scheme.from_stream else scheme.pad(self.record.state) >= 0
        return self._last_symbol and carried

    def _saved(self, actions: Actions) -> Actions:
        """``actions``, which save the record as it is now, with all that belongs to it.

        They may save it already, as it was before.
        """
        self.record = self.record._replace(confirmed=self.keys.confirmed)
        rows = self.keys.rows()
        if actions.record is not None:
            rows = actions.rows.and_then(rows)
        return actions._replace(record=self.record, rows=rows)

    def _report(self, offer: Offer, x_next: Vector) -> Measurement:
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
            keyed=bool(self._taken) if self.rules.digits else None,
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

    def _count(self) -> Actions:
        """Count the transition that the step made.

        The key is what the test returns, as for the controller; the coin is only compared with it.
        """
        record, offer, coin, report = self.record, self._offer, self._tossed, self._said
        assert offer is not None
        assert report is not None
        u, x_next = offer.candidates[coin], report.x
        scheme = self.rules.scheme
        box = self.rules.box(record.estimate, record.k - record.applied_k - 1, record.x)
        verdict = self.rules.judge(record.x, offer.candidates, offer.predictions, x_next, box)
        after, carry = scheme.follow(record.state, verdict.symbol)
        agreed, pad = carry
        if scheme.from_stream and self._taken:
            pad = self._taken[-1]
            carry = carry._replace(pad=pad)
        symbol, payload, refusal = NO_SYMBOL, None, False
        partial, symbols, stored = record.partial, "", record.stored
        if pad != NO_SYMBOL:
            symbol = decrypt(offer.cipher, pad, scheme.alphabet)
            refused = self.deframer.refused
            payload = self.deframer.push(symbol)
            refusal = self.deframer.refused > refused
            partial = f"{partial}{symbol:0{self._digits}x}"
            if len(partial) >= SYMBOLS_AT_ONCE * self._digits:
                partial, symbols = "", partial
                stored += len(symbols)
            if not self.deframer.symbols:
                partial, symbols, stored = "", "", 0
        contribution = self.keys.count(
            record.transitions,
            record.k - record.applied_k,
            offer,
            offer.copy_number,
            record.nonce,
        )
        transition = CountedTransition.of(
            scheme,
            record,
            offer,
            x_next,
            verdict,
            after,
            carry,
            symbol,
            contribution,
            coin,
            u,
            self._truth,
            bool(self._taken),
            recovered=payload,
            refused=refusal,
        )
        self.record = record._replace(
            k=record.k + 1,
            x=x_next,
            u=u,
            applied_k=record.k,
            x_after=x_next,
            partial=partial,
            stored=stored,
            state=after,
            transitions=record.transitions + 1,
            p=transition.p,
            agreements=record.agreements + (agreed != NO_SYMBOL),
            symbol_errors=record.symbol_errors + (agreed not in (NO_SYMBOL, coin)),
            messages=record.messages + (payload is not None),
            frames_refused=record.frames_refused + refusal,
            nonce=report.nonce,
            applied_copy=report.applied_copy,
            block=report.block,
            tag=report.tag,
            blocks_begun=record.blocks_begun + (contribution is not None and self.keys.began),
            keyed=bool(report.keyed),
            estimate=verdict.estimate,
            true_x=self._state_of(self._truth),
        )
        self._offer, self._tossed, self._said = None, NO_SYMBOL, None
        self._last_symbol = self.deframer.lacks_one
        self.state = TABLE[self.state, "offer applied"].next
        if self._taken:
            self.keys.used(offer.position, self.rules.digits)
            self._taken = ()
        self.coin.prepare(self.record.transitions)
        self.plant.prepare(self.record.k)
        contradicted = None if self._telemetry is None else self._telemetry.counted(transition)
        ended = payload is not None or refusal
        notices = self._frame_ended(transition) if ended else ()
        if contradicted is not None:
            notices = (*notices, Notice(contradicted, "warning"))
        actions = Actions((transition,), received=payload, symbols=symbols, notices=notices)
        if symbols or ended:  # else the next step saves the record
            actions = self._saved(actions)
        return self._with_keys(actions) if self.keys.on else actions

    def _frame_ended(self, transition: CountedTransition) -> tuple[Notice, ...]:
        """What is told of a frame that is whole, or failed its check."""
        payload, k = transition.recovered, transition.k
        if payload is None:
            return (Notice("a frame failed its check and was refused", "error"),)
        if self._telemetry is not None:
            self._telemetry.last_message, self._telemetry.message_k = payload, k
        if self._finished:
            self._report_stopped()
        self._status_soon()
        return (Notice(f"message recovered at step {k}: {len(payload)} bytes"),)

    def _with_keys(self, actions: Actions) -> Actions:
        """``actions``, and what has become of key blocks."""
        ended = self.keys.ended()
        actions = actions._replace(
            events=(*ended, *actions.events),
            tasks=self.keys.tasks(),
            notices=(*actions.notices, *block_notices(self.keys, ended)),
        )
        if any(block.what == "unequal" for block in ended):
            self.state = TABLE[self.state, "blocks differ"].next
            self._begin_session()
            notice = Notice(f"{BLOCKS_DIFFER}; new session {self.record.session}", "error")
            return self._anew(BLOCKS_DIFFER, notice, actions)
        return actions

    # --- steps without an offer -------------------------------------------------------------------

    def _miss(self) -> Actions:
        """No offer came in time (rule 4).

        A model makes the step under the fallback. A device has already made it, under the input in
        force; the fallback is applied for the step to come.
        """
        record = self.record
        u = record.u
        if not self.plant.device:
            u = self._instead()
            self.plant.begin(record.k, record.x, u)
        x_next = self.plant.end(record.k)
        self._missed(u, x_next)
        self._fall_back(sure=True)
        if not self._moved:  # from its first step on the watchdog has its own time
            self._moved = True
            self._watchdog_at = min(self._watchdog_at, self.now + self._patience_s)
        missed = Missed(record.session, record.k, record.x, u, x_next, self.plant.truth)
        return self._saved(Actions((missed,)))

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
        record, offer, coin = self.record, self._offer, self._tossed
        candidates = () if offer is None else offer.candidates
        u = record.u if offer is None else offer.candidates[coin]
        self._offer, self._tossed = None, NO_SYMBOL
        self._missed(u, x_next)
        self._fall_back(sure=sure or offer is None)
        truth = self.plant.truth
        return Interrupted(record.session, record.k, record.x, u, x_next, candidates, coin, truth)

    def _came_back(self, actions: Actions) -> Actions:
        """After ``actions``: what a process has to do that goes on with a journal, once.

        The step in which the process of a plant that acts died is missed. Where the newest steps
        may be lost a new session begins: the controller may have lost as many, and neither could
        tell.
        """
        if self._back is not None:
            event = self._interrupted(self._back)
            self._back = None
            actions = self._saved(actions)._replace(events=(*actions.events, event))
        if self._fell_back:
            self._fell_back = False
            self._begin_session()
            self.state = first_state(self.record)
            notice = Notice(f"{FELL_BACK}; new session {self.record.session}", "warning")
            actions = self._anew(FELL_BACK, notice, actions)
        return actions

    # --- sessions ---------------------------------------------------------------------------------

    def _heard_hello(self, hello: ControllerHello) -> Actions:
        """The controller spoke on the management bus: do as the table says."""
        if self._finished:
            return NOTHING_TO_DO
        what = heard(
            hello,
            self.record,
            instance=self.instance,
            fingerprint=self.rules.fingerprint,
            asked=self.controller,
            met=self._met,
        )
        answer, self.state = TABLE[self.state, what]
        if answer in ("ask", "begin and ask"):
            self.controller = hello.instance
            self.record = self.record._replace(
                controller=hello.instance, incarnation=hello.incarnation
            )
        if hello.instance == self.controller:
            self.answered_at = self.now
        if answer == "ask":
            asking = Actions(offer=self._offer, coin=self._tossed, publish=(self._hello(),))
            return self._saved(asking)
        if answer in ("begin anew", "begin and ask"):
            self._begin_session()
            notice = Notice(f"session ended; new session {self.record.session}", "warning")
            return self._anew(UNKNOWN_THERE, notice)
        if answer == "work":
            return self._accepted_by(hello)
        if answer in ("say whose", "say model"):
            return self._speaks_up(hello, what)
        if answer == "give up":
            detail = (
                f"the controller's model is {hello.fingerprint[:8]}, "
                f"this plant's is {self.rules.fingerprint[:8]}"
            )
            self._set_phase("refused", detail)
            return _logged(f"{detail}: the two ends must share one scenario", "error")
        return NOTHING_TO_DO

    def _accepted_by(self, hello: ControllerHello) -> Actions:
        self._met = True
        self._set_phase("running")
        taken_up = (hello.instance, self.record.session)
        if taken_up == self._taken_up:
            return NOTHING_TO_DO
        self._taken_up = taken_up
        return _logged(f"controller {hello.instance} took up session {self.record.session}")

    def _speaks_up(self, hello: ControllerHello, what: Heard) -> Actions:
        """Answer a controller that does not have this session."""
        text = f"speaks up while controller {self.controller} has the session: "
        text += "two controllers on one loop?"
        publish: tuple[Message, ...] = (self._hello(),)
        if what in ("another model", "another model, never met"):
            text = f"has another model, {hello.fingerprint[:8]}; ignored"
            if hello.verdict != "greeting":
                publish = ()
        notice = Notice(f"controller {hello.instance} {text}", "warning", "incompatible")
        return Actions(publish=publish, notices=(notice,))

    def _hello(self) -> PlantHello:
        """Ask the controller to take up this session, or look for one."""
        record = self.record
        return PlantHello(
            instance=self.instance,
            session=record.session,
            controller=None if self.state in TO_ANYONE else self.controller,
            incarnation=record.incarnation,
            fingerprint=self.rules.fingerprint,
            transitions=record.transitions,
            applied_k=record.applied_k,
        )

    def _begin_session(self) -> None:
        """A new session: all that was agreed or half received in the one before is dropped."""
        session = self._new_id()
        self.deframer.reset()
        self._last_symbol = False
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
        self._taken = ()

    def _anew(self, why: str, notice: Notice, before: Actions = NOTHING_TO_DO) -> Actions:
        """The actions of a new session, added to those of ``before``."""
        self._set_phase("greeting")
        record = self.record
        return before._replace(
            events=(*before.events, SessionBegan(record.session, why)),
            record=record,
            offer=self._offer,
            coin=self._tossed,
            symbols="",
            rows=NO_ROWS,
            publish=(*before.publish, self._hello()),
            notices=(*before.notices, notice),
        )

    def _malformed(self, text: str) -> Actions:
        self.malformed += 1
        return Actions(notices=(Notice(text, "warning", "malformed"),))

    # --- the end ----------------------------------------------------------------------------------

    def _farewell(self) -> Actions:
        """Report the last transition until the controller has answered, or a second has passed."""
        now = self.now
        if self._gives_up_at is None:
            self._gives_up_at = now + self._farewell_s
        if now >= self._gives_up_at:
            self.code = DONE
            return NOTHING_TO_DO
        self._last_at = now + LOCKSTEP_REPEAT_S
        return Actions(publish=(self._measurement(),))

    # --- the watchdog and the status --------------------------------------------------------------

    @property
    def _patience_s(self) -> float:
        """Seconds without an applied offer that the watchdog allows."""
        return self._watchdog_s if self._moved else max(self._watchdog_s, MEETING_S)

    def status(self, now: float, *, whole: bool = True) -> PlantStatus:
        """What the dashboard is told; a plant without telemetry has none."""
        assert self._telemetry is not None
        return self._telemetry.status(
            self.record, self.deframer, self.keys, self.malformed, now, whole=whole
        )

    def _status(self) -> Actions:
        """A status to publish, its model before it where that is due, and to keep once a second."""
        telemetry = self._telemetry
        if telemetry is None:
            return NOTHING_TO_DO
        whole = telemetry.model_is_due()
        status = self.status(self.now, whole=whole)
        kept = status if telemetry.health_is_due(self.now) else None
        if whole:  # who hears this one lacks nothing
            return Actions(publish=(telemetry.model, status), health=kept)
        return Actions(publish=(status,), health=kept)

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


def _logged(text: str, level: Literal["info", "error"] = "info") -> Actions:
    return Actions(notices=(Notice(text, level),))
