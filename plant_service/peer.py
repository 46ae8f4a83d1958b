"""The plant's end of the link with its timers, sans I/O.

What it says of itself is in :mod:`plant_service.telling`. The rest is one machine of messages and
timers, whose parts share every field; that is why it is a little longer than other modules.
"""

from collections.abc import Callable
from math import inf
from typing import Final, Literal

from pydantic import ValidationError

from plant_service.adapters.base import PlantError
from plant_service.plant import Move
from plant_service.status import PlantTelemetry
from plant_service.stepper import Stepper
from plant_service.telling import Telemetry
from protocol.link.events import (
    NEW_JOURNAL,
    Applied,
    FrameRefused,
    Missed,
    Recovered,
    SessionBegan,
)
from protocol.link.key_events import appeared, key_actions, waiting_notice
from protocol.link.pacing import LOCKSTEP_REPEAT_S, STATUS_S, Pacing
from protocol.link.peer import NOTHING_TO_DO, Actions, Append, Notice, Outgoing, Save
from protocol.link.receiver import ReceiverEffects
from protocol.link.session import SILENCE_S
from protocol.messages import (
    BlockAnnouncement,
    ControllerHello,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantModel,
    PlantStatus,
)
from protocol.schemes.framing import Frame
from protocol.secret.tasks import Done
from runtime.errors import DONE, USAGE
from runtime.ids import proquint

HELLO_S: Final = 0.1
"""Seconds between hellos until the controller answers."""

MEETING_S: Final = 10.0
"""Seconds at least that a plant which has never moved has for meeting its controller, before its
watchdog bites: a controller starts in some of them."""

LAST_WORD_S: Final = 1.0
"""Seconds to wait at the end for the controller to count the last transition."""

LAST_KEYS_S: Final = 20.0
"""Seconds to wait at the end for key blocks that are whole to be confirmed at both ends."""

LAST_KEYS_REPEAT_S: Final = 0.05


class PlantPeer:
    """The plant's end of one loop.

    Parameters
    ----------
    plant : Stepper
    pacing : Pacing
    new_id : callable
        A random id for each session to begin.
    now : float
        The time.
    pending : Move, optional
        A step of the journal's that was not counted.
    fresh : bool
        The record is a new one, and in no journal yet.
    steps : int, optional
        The last step: when k has come there the endpoint reports it, and is over.
    news : PlantTelemetry, optional
        What is told beside the record; without it no status is published.
    status_s : float
        Seconds between statuses.
    watchdog_s : float, optional
        Seconds without an applied offer after which the plant goes to its safe state: counted from
        :meth:`start` on, so that a plant that was started again is watched while its controller is
        away. One that has never moved has :data:`MEETING_S` at least to meet it.
    """

    hears: tuple[type[Message], ...] = (Offer, ControllerHello, BlockAnnouncement)
    says: tuple[type[Message], ...] = (
        Measurement,
        PlantHello,
        PlantModel,
        PlantStatus,
        BlockAnnouncement,
    )

    def __init__(
        self,
        plant: Stepper,
        pacing: Pacing,
        new_id: Callable[[], str],
        now: float,
        *,
        pending: Move | None = None,
        fresh: bool = False,
        steps: int | None = None,
        news: PlantTelemetry | None = None,
        status_s: float = STATUS_S,
        watchdog_s: float | None = None,
    ) -> None:
        self.plant = plant
        self.malformed = 0
        self.code: int | None = None
        self._pacing = pacing
        self._new_id = new_id
        self._now = now
        self._uncounted = pending
        self._fresh = fresh
        self._steps = steps
        self._telemetry = Telemetry(news, status_s, now, plant.receiver.instance)
        self._hello_at = self._last_at = -inf
        self._answered_at = now
        self._latest_late_k = self._measured_k = -1
        self._measured_at = now
        self._taken_up = ("", "")
        self._moved = plant.receiver.record.k > 0 or pending is not None
        self._gives_up_at: float | None = None
        self._counted = False  # the last step, by the controller
        self._keys_until: float | None = None
        self._waiting_there = 1  # until it says how many
        self._watchdog_s = inf if watchdog_s is None else watchdog_s
        self._watchdog_at = inf

    @property
    def _running(self) -> bool:
        """Whether ticks count: not before the plant has moved or is sure of a controller."""
        return self._moved or self.plant.receiver.accepted

    @property
    def _patience_s(self) -> float:
        """Seconds without an applied offer that the watchdog allows."""
        return self._watchdog_s if self._moved else max(self._watchdog_s, MEETING_S)

    @property
    def _finished(self) -> bool:
        return self._steps is not None and self.plant.receiver.record.k >= self._steps

    # --- the shell's side -------------------------------------------------------------------------

    def start(self, now: float) -> Actions:
        """Say which session this is; a step that the journal holds is counted now."""
        self._now = now
        self._watchdog_at = now + self._patience_s
        record = self.plant.receiver.record
        reason = NEW_JOURNAL if self._fresh else "resumed from the journal"
        return Actions(
            events=(SessionBegan(record.session, reason),),
            write=Save(record) if self._fresh else None,
            keys=self.plant.receiver.keying.tasks(),
            finish_step=self._uncounted is not None,
        )

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """An offer, or a word of the controller's."""
        self._now = now
        if not self._running:
            self._pacing.tick(now, running=False)
        try:
            if kind is Offer:
                return self._offered(payload, now)
            if kind is BlockAnnouncement:
                return self._heard_announcement(BlockAnnouncement.model_validate_json(payload))
            return self._heard(ControllerHello.model_validate_json(payload), now)
        except ValidationError as error:
            what = {Offer: "offer", BlockAnnouncement: "word"}.get(kind, "hello")
            return self._malformed(f"{what}: {error.error_count()} fields not as expected; ignored")

    def wake_at(self) -> float:
        """The earliest of tick, repeat, hello, silence and status."""
        receiver, pacing = self.plant.receiver, self._pacing
        if receiver.refused:
            return -inf
        if self._finished:
            return self._last_at
        due = min(
            self._telemetry.at,
            self._watchdog_at,
            pacing.due_at(running=self._running, measuring=receiver.accepted),
        )
        if not receiver.accepted:
            return min(due, self._hello_at)
        if pacing.waiting:
            return due
        return min(due, max(self._hello_at, self._answered_at + SILENCE_S))

    def wake(self, now: float) -> Actions:
        """A tick, a repeated measurement, a hello, a status: whatever is due."""
        self._now = now
        receiver, pacing = self.plant.receiver, self._pacing
        if receiver.refused:
            self.code = USAGE
            return NOTHING_TO_DO
        if self._finished:
            return self._last_word(now)
        if now >= self._watchdog_at:
            why = f"the watchdog: no offer was applied for {self._patience_s:g} s"
            self.plant.safe(why)
            raise PlantError(why)
        if pacing.waiting:
            self._answered_at = now
        publish: list[Outgoing] = []
        silent = now >= self._answered_at + SILENCE_S  # as in wake_at, to the last bit
        if silent:
            receiver.look_around()
        if (silent or not receiver.accepted) and now >= self._hello_at:
            self._hello_at = now + HELLO_S
            publish.append(self._hello())
        actions = NOTHING_TO_DO
        over = pacing.tick(now, running=self._running)
        if over != "nothing":
            self._telemetry.ticked(pacing.late_s, pacing.overruns)
        if over == "missed":
            actions = self._missed()
        elif over == "ended":
            actions = self._ended()
        status, health = self._telemetry.due(receiver, self.malformed, now)
        publish += status
        if receiver.accepted and not actions.finish_step and pacing.measurement_due(now):
            k = receiver.record.k
            if k != self._measured_k:
                self._measured_k, self._measured_at = k, now
            publish.append(Outgoing(Measurement, receiver.measurement().wire()))
        return actions._replace(publish=(*actions.publish, *publish), health=health)

    def finish_step(self) -> Actions:
        """Count the step that was saved and reported."""
        move, self._uncounted = self._uncounted, None
        assert move is not None
        step = self.plant.count(move)
        assert step.effects is not None
        assert step.coin is not None
        contradicted = self._telemetry.counted(step)
        effects, frame, record = step.effects, step.effects.frame, self.plant.receiver.record
        applied = Applied(effects.transition, step.coin, step.u)
        if frame is None:
            write = Save(record, later=not effects.chunk, chunk=effects.chunk)
            actions = Actions((applied,), write)
        else:
            actions = self._frame_ended(applied, effects.chunk, frame)
        if contradicted is not None:
            notice = Notice(contradicted, "warning")
            actions = actions._replace(notices=(*actions.notices, notice))
        if not self.plant.receiver.keying.on:
            return actions
        return self._keyed(actions, effects)

    def _keyed(self, actions: Actions, effects: ReceiverEffects) -> Actions:
        """Add what the transition means for keys."""
        receiver = self.plant.receiver
        keying = receiver.keying
        tasks = keying.tasks(effects.judged)
        if all(judgement.what != "unequal" for judgement in effects.judged):
            assert isinstance(actions.write, Save)
            obsolete_rows = keying.obsolete_rows()
            # Rows that go cost a rare write: now, and not when a step hangs on it.
            later = actions.write.later and not obsolete_rows
            write = actions.write._replace(
                contribution=effects.contribution, obsolete_rows=obsolete_rows, later=later
            )
            return actions._replace(write=write, keys=tasks)
        receiver.end_session(self._new_id())
        text = "a key block differs from the controller's"
        notice = Notice(f"{text}; new session {receiver.record.session}", "error")
        return self._anew(text, notice, actions)._replace(keys=tasks)

    def key_task_done(self, done: Done, now: float) -> Actions:
        """The keeper of keys has done a task; rows that nobody needs any more go at once."""
        self._now = now
        actions = key_actions(self.plant.receiver.keying, done)
        return actions._replace(write=self._erase_rows())

    @property
    def _between_steps(self) -> bool:
        """Whether the record is all that the journal must hold."""
        return self._uncounted is None

    def _erase_rows(self) -> Save | None:
        """What has the journal erase the rows of blocks that are confirmed, if there are any."""
        receiver = self.plant.receiver
        obsolete_rows = receiver.keying.obsolete_rows() if self._between_steps else ()
        return Save(receiver.record, obsolete_rows=obsolete_rows) if obsolete_rows else None

    def appear(self, count: int) -> Actions:
        """From now on a message leaves ``count`` times."""
        record = self.plant.receiver.record
        return appeared(self.plant.receiver.keying, record.session, record.k, count)

    def stop(self, now: float) -> Actions:
        """The last status."""
        self._now = now
        self._telemetry.stopped()
        self.plant.safe("the process ended")
        failed = self.plant.close()
        receiver = self.plant.receiver
        publish, health = self._telemetry.status(receiver, self.malformed, now, force=True)
        timing = self._telemetry.timing(receiver.record.k)
        notices = waiting_notice(receiver.keying)
        if failed:
            notices = (*notices, Notice(failed, "error"))
        return Actions(
            timing,
            write=self._erase_rows(),
            publish=publish,
            notices=notices,
            health=health,
        )

    def status(self, now: float) -> PlantStatus:
        """What the dashboard is told; an endpoint without news has none."""
        news = self._telemetry.news
        assert news is not None
        return news.status(self.plant.receiver, self.malformed, now)

    # --- steps ------------------------------------------------------------------------------------

    def _offered(self, payload: bytes, now: float) -> Actions:
        """If the offer is for this step: apply it, save, report, and only then count."""
        receiver, pacing = self.plant.receiver, self._pacing
        offer = Offer.model_validate_json(payload)
        record = receiver.record
        if self._finished:  # all that matters now is that the last step was counted
            if offer.k == record.k and not self._counted:
                self._counted, self._last_at = True, now
                return self._last_keys(now)
            return NOTHING_TO_DO
        try:
            what = receiver.check(offer)
        except ValueError as error:
            return self._malformed(f"{error}; ignored")
        if what != "foreign":
            self._answered_at = now
        if what == "stale" and max(record.applied_k, self._latest_late_k) < offer.k < record.k:
            # Its step was missed. (An answer to a repeated measurement, whose step was made, is
            # not late; nor is it late twice.)
            self._latest_late_k = offer.k
            pacing.answered_late()
            self._telemetry.answered_late()
        if what != "current" or pacing.waiting:
            return NOTHING_TO_DO
        if self._measured_k == record.k:
            self._telemetry.answered(now - self._measured_at)
        return self._apply(offer, payload, now)

    def _acted(self, now: float) -> None:
        """An offer was applied."""
        if self._pacing.timed:
            self._telemetry.acted(self._pacing.since_tick_s(now))
        self._pacing.applied()
        self._moved = True
        self._watchdog_at = now + self._watchdog_s

    def _ended(self) -> Actions:
        """The step whose offer was applied is over; it was computed when it began."""
        return NOTHING_TO_DO

    def _apply(self, offer: Offer, payload: bytes, now: float) -> Actions:
        receiver, pacing = self.plant.receiver, self._pacing
        self._uncounted = move = self.plant.move(offer)
        report = receiver.moved(offer, move.x_next).wire()
        self._acted(now)
        due = receiver.accepted and pacing.measurement_due(now)
        if due:
            receiver.reported()
            self._measured_k, self._measured_at = receiver.record.k + 1, now
        return Actions(
            write=Append(payload, report, move.coin),
            publish=(Outgoing(Measurement, report),) if due else (),
            finish_step=True,
        )

    def _frame_ended(self, applied: Applied, chunk: str, frame: Frame) -> Actions:
        record, k = self.plant.receiver.record, applied.transition.k
        write = Save(
            record,
            chunk=chunk,
            drop_chunks=True,
            received=frame.payload if frame.intact else None,
        )
        if not frame.intact:
            refused = FrameRefused(record.session, record.p)
            notice = Notice("a frame failed its check and was refused", "error")
            return Actions((applied, refused), write, notices=(notice,))
        self._telemetry.recovered(frame.payload, k)
        text = f"message recovered at step {k}: {len(frame.payload)} bytes"
        if self._finished:
            self._telemetry.stopped()
        receiver = self.plant.receiver
        publish, health = self._telemetry.status(receiver, self.malformed, self._now, force=True)
        events = (applied, Recovered(frame.payload))
        return Actions(events, write, publish, (Notice(text),), health)

    def _has_moved(self) -> None:
        """From its first step on the watchdog has its own time."""
        if not self._moved:
            self._moved = True
            self._watchdog_at = min(self._watchdog_at, self._now + self._patience_s)

    def _missed(self) -> Actions:
        step = self.plant.miss()
        record = self.plant.receiver.record
        self._has_moved()
        missed = Missed(record.session, step.k, step.x, step.u, step.x_next)
        obsolete_rows = self.plant.receiver.keying.obsolete_rows()
        return Actions(events=(missed,), write=Save(record, obsolete_rows=obsolete_rows))

    def _last_word(self, now: float) -> Actions:
        """Report the last transition until the controller has answered, or a second has passed."""
        if self._gives_up_at is None:
            self._gives_up_at = now + LAST_WORD_S
        elif now >= self._gives_up_at and not self._counted:
            self.code = DONE
            return NOTHING_TO_DO
        if self._counted:
            return self._last_keys(now)
        self._last_at = now + LOCKSTEP_REPEAT_S
        measurement = self.plant.receiver.measurement().wire()
        return Actions(publish=(Outgoing(Measurement, measurement),))

    def _last_keys(self, now: float) -> Actions:
        """Wait for blocks that are whole, at both ends, and no longer than :data:`LAST_KEYS_S`."""
        receiver = self.plant.receiver
        keying, waits = receiver.keying, max(receiver.keying.waiting, self._waiting_there)
        notices: tuple[Notice, ...] = ()
        if self._keys_until is None:
            self._keys_until = now + LAST_KEYS_S
            if keying.waiting:
                text = f"waiting for key blocks that are whole: {keying.waiting}, "
                text += f"{LAST_KEYS_S:g} s at most"
                notices = (Notice(text),)
        if not keying.on or not waits or now >= self._keys_until:
            self.code = DONE
            return Actions(notices=notices)
        self._last_at = now + LAST_KEYS_REPEAT_S
        word = keying.block_announcement("plant", receiver.record.session)
        return Actions(publish=(Outgoing(BlockAnnouncement, word.wire()),), notices=notices)

    def _heard_announcement(self, word: BlockAnnouncement) -> Actions:
        """The controller's word on blocks, after the last step."""
        receiver = self.plant.receiver
        keying = receiver.keying
        if word.side != "controller" or word.session != receiver.record.session or not keying.on:
            return NOTHING_TO_DO
        self._waiting_there = word.waiting
        judged = keying.heard(word)
        if any(judgement.what == "unequal" for judgement in judged):
            self._waiting_there = 0  # nothing of this session comes any more
        return Actions(keys=keying.tasks(judged))

    # --- sessions ---------------------------------------------------------------------------------

    def _heard(self, hello: ControllerHello, now: float) -> Actions:
        """The controller spoke on ops."""
        if self._finished:
            return NOTHING_TO_DO
        receiver = self.plant.receiver
        outcome = receiver.heard_controller(hello, self._new_id())
        if hello.instance == receiver.controller:
            self._answered_at = now
        if outcome == "nothing":
            return NOTHING_TO_DO
        greeted = outcome == "incompatible" and hello.verdict == "greeting"
        answers = outcome in ("greet", "competing") or greeted
        publish = (self._hello(),) if answers else ()
        record = receiver.record
        if outcome == "refused":
            detail = (
                f"the controller's model is {proquint(hello.fingerprint)}, "
                f"this plant's is {proquint(receiver.rules.fingerprint)}"
            )
            self._telemetry.phase("refused", detail)
            return _told(f"{detail}: the two ends must share one scenario", "error")
        if outcome in ("incompatible", "competing"):
            model = f"has another model, {proquint(hello.fingerprint)}; ignored"
            competing = f"speaks up while controller {receiver.controller} has the session: "
            competing += "two controllers on one loop?"
            text = f"controller {hello.instance} {competing if outcome == 'competing' else model}"
            return Actions(publish=publish, notices=(Notice(text, "warning", "incompatible"),))
        if outcome == "accepted":
            self._telemetry.phase("running")
            taken_up = (hello.instance, record.session)
            if taken_up == self._taken_up:
                return NOTHING_TO_DO
            self._taken_up = taken_up
            return _told(f"controller {hello.instance} took up session {record.session}")
        if outcome == "ended":
            notice = Notice(f"session ended; new session {record.session}", "warning")
            return self._anew("the controller does not know the session before", notice)
        return Actions(write=Save(record), publish=publish)

    def _anew(self, why: str, notice: Notice, before: Actions = NOTHING_TO_DO) -> Actions:
        """A new session has begun, beside what is to be done ``before``."""
        self._telemetry.phase("greeting")
        record = self.plant.receiver.record
        write = before.write if isinstance(before.write, Save) else Save(record)
        return before._replace(
            events=(*before.events, SessionBegan(record.session, why)),
            write=write._replace(record=record, later=False, chunk="", drop_chunks=True),
            publish=(*before.publish, self._hello()),
            notices=(*before.notices, notice),
        )

    def _hello(self) -> Outgoing:
        return Outgoing(PlantHello, self.plant.receiver.hello().wire())

    def _malformed(self, text: str) -> Actions:
        self.malformed += 1
        return Actions(notices=(Notice(text, "warning", "malformed"),))


def _told(text: str, level: Literal["info", "error"] = "info") -> Actions:
    return Actions(notices=(Notice(text, level),))
