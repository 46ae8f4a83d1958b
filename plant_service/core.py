"""The plant's end of the link, sans I/O: which machine is asked about a message, and when.

The rules are those of :mod:`protocol.link.session`. Which controller the session is with stands in
:mod:`protocol.link.plant_session`, a step in :mod:`plant_service.stepper`.
"""

from collections.abc import Callable
from math import inf
from typing import ClassVar, Literal

from plant_service.adapters.base import PlantError
from plant_service.plant import Plant
from plant_service.state import PlantState
from plant_service.status import PlantTelemetry
from plant_service.stepper import Stepper
from plant_service.watchdog import Farewell, Watchdog
from protocol.link.channel import Channel
from protocol.link.effects import Effects, Extract, Notice, Publish, Tell
from protocol.link.endpoint import Endpoint
from protocol.link.events import (
    BLOCKS_DIFFER,
    FELL_BACK,
    NEW_JOURNAL,
    RESUMED,
    UNKNOWN_THERE,
    AttackBegan,
    PowerFailed,
    SessionBegan,
)
from protocol.link.pacing import Pacing
from protocol.link.plant_session import first_state
from protocol.link.records import Loaded, PlantRecord
from protocol.link.session import Rules
from protocol.link.step import IDLE, Begun, Read
from protocol.messages import (
    ControllerHello,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantModel,
    PlantStatus,
)
from protocol.secret.nonces import NonceSource
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import DONE, USAGE


class PlantCore(Endpoint):
    """The plant's end of one loop.

    Parameters
    ----------
    rules : Rules
    plant : Plant
        What is stepped.
    coin : SymbolSource
        b_r; draw j belongs to transition j.
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
    first : PlantRecord, optional
        The record of a new session, where the journal has none.
    back : tuple of float, optional
        What a plant that acts has read first, where it is back with a journal; else None.
    steps : int, optional
        The last step: when k has come there the plant reports it, and is over.
    news : PlantTelemetry, optional
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
    channel : Channel, optional
        What offers pass before they arrive.

    Attributes
    ----------
    state : PlantState
    stepper : Stepper
    """

    receives: ClassVar[tuple[type[Message], ...]] = (Offer, ControllerHello)
    sends: ClassVar[tuple[type[Message], ...]] = (Measurement, PlantHello, PlantModel, PlantStatus)

    state: PlantState
    news: PlantTelemetry

    def __init__(
        self,
        rules: Rules,
        plant: Plant,
        coin: SymbolSource,
        fallback: Callable[[Vector, Vector], Vector],
        pacing: Pacing,
        new_id: Callable[[], str],
        now: float,
        *,
        instance: str,
        loaded: Loaded[PlantRecord],
        first: PlantRecord | None = None,
        back: Vector | None = None,
        steps: int | None = None,
        news: PlantTelemetry | None = None,
        watchdog_s: float | None = None,
        attack: AttackBegan | None = None,
        nonces: NonceSource = fresh_nonce,
        round_trip_s: float = 0.0,
        channel: Channel | None = None,
    ) -> None:
        super().__init__(instance, channel)
        record = loaded.record or first
        assert record is not None
        self.state = PlantState(
            rules,
            record,
            loaded,
            nonces,
            now,
            instance,
            pacing,
            Watchdog(watchdog_s),
        )
        self.news = PlantTelemetry() if news is None else news
        self.stepper = Stepper(self.state, self.news, plant, coin, fallback)
        self._new_id = new_id
        self._steps = steps
        self._fresh, self._fell_back = loaded.record is None, loaded.fell_back
        self._back, self._attack = back, attack
        self._farewell = Farewell(round_trip_s)

    @property
    def _finished(self) -> bool:
        return self._steps is not None and self.state.link.k >= self._steps

    # --- from the first to the last word ----------------------------------------------------------

    def start(self, now: float) -> Effects:
        """Say which session this is; a step that the journal holds is counted now.

        The step in which the process of a plant that acts died is missed. Where the newest steps
        may be lost a new session begins: the controller may have lost as many, and neither could
        tell.
        """
        state = self.state
        state.now = now
        self.news.soon(now)
        state.watchdog.begin(now, moved=state.moved)
        if self._fell_back:
            yield Tell(PowerFailed())
        reason = NEW_JOURNAL if self._fresh else RESUMED
        yield Tell(SessionBegan(state.session.record.id, reason))
        if self._attack is not None:
            yield Tell(self._attack)
        if self._fresh:
            yield state.save()
        yield from map(Extract, state.keys.tasks())
        if isinstance(state.step, Read):
            offer, _, report = state.step
            digits = state.digits(offer.position) if report.keyed else ()
            yield from self._counted(self.stepper.count(state.step, digits))
        if self._back is not None:
            yield Tell(self.stepper.interrupted(self._back))
            yield state.save()
        if self._fell_back:
            self._begin_session()
            state.session.state = first_state(state.link)
            yield from self._anew(FELL_BACK, f"{FELL_BACK}; new session", "warning")

    def stop(self, now: float) -> Effects:
        """The last status. The plant goes to its safe state and is closed."""
        state = self.state
        state.now = now
        self.news.stop()
        self.stepper.plant.safe("the process ended")
        failed = self.stepper.plant.close()
        self.news.soon(now)
        timing = self.news.punctuality.as_event(state.link.k)
        if timing is not None:
            yield Tell(timing)
        if state.step is IDLE:  # else digits that have served are erased with the next step
            yield state.save()
        yield from self.publish_status()
        if failed:
            yield Notice(failed, "error")

    # --- messages ---------------------------------------------------------------------------------

    def hear(self, message: Message, now: float) -> Effects:
        """An offer, or a hello of the controller."""
        state = self.state
        state.now = now
        if not state.running:
            state.pacing.tick(now, running=False)
        match message:
            case Offer() if self._finished:  # all that matters is that the last step was counted
                if message.k == state.link.k:  # the controller has counted it
                    self.code = DONE
            case Offer():
                if wrong := self.stepper.wrong(message):
                    return self.reject(wrong)
                return self._counted(self.stepper.offered(message))
            case ControllerHello() if not self._finished:
                return self._greeted(message)
        return ()

    def _counted(self, effects: Effects) -> Effects:
        """A step's effects; the session ends where a key block or a word turns out to differ."""
        yield from effects
        state = self.state
        if state.keys.unequal or state.rules.scheme.differs(state.link.state):
            self.state.session.on("blocks differ")
            self._begin_session()
            yield from self._anew(BLOCKS_DIFFER, f"{BLOCKS_DIFFER}; new session", "error")

    # --- time -------------------------------------------------------------------------------------

    def due_at(self) -> float:
        """The earliest of tick, repeat, hello, silence, status and watchdog."""
        state = self.state
        session, pacing = state.session, state.pacing
        if session.state == "refused":
            return -inf
        if self._finished:
            return self._farewell.due_at
        accepted = session.accepted
        return min(
            self.news.due_at,
            state.watchdog.at,
            pacing.due_at(running=state.moved or accepted, measuring=accepted),
            session.due_at(waiting=pacing.waiting),
        )

    def act(self, now: float) -> Effects:
        """A tick, a repeated measurement, a hello, a status: whatever is due."""
        state = self.state
        session, pacing, news = state.session, state.pacing, self.news
        state.now = now
        if session.state == "refused":
            self.code = USAGE
            return
        if self._finished:  # the last transition is reported until it is counted
            if self._farewell.over(now):
                self.code = DONE
            else:
                yield Publish(self.stepper.measurement())
            return
        if now >= state.watchdog.at:
            patience = state.watchdog.patience_s(moved=state.moved)
            why = f"the watchdog: no offer was applied for {patience:g} s"
            self.stepper.plant.safe(why)
            raise PlantError(why)
        if pacing.waiting:
            session.answered_at = now
        if session.hello_due(now):
            yield Publish(session.hello(state.link))
        over = pacing.tick(now, running=state.running)
        if over != "nothing":
            news.punctuality.ticked(pacing.late_s, pacing.overruns)
        if over == "missed":
            yield from self.stepper.miss()
        elif over == "ended" and isinstance(state.step, Begun):
            digits = state.digits(state.step.offer.position)
            yield from self._counted(self.stepper.read(state.step, digits))
        if session.accepted and pacing.measurement_due(now):
            yield Publish(self.stepper.measurement())
        if news.is_due(now, self.instance):
            yield from self.publish_status()

    # --- sessions ---------------------------------------------------------------------------------

    def _greeted(self, hello: ControllerHello) -> Effects:
        """The controller spoke on the management bus: do as the table says."""
        state = self.state
        session, link = state.session, state.link
        answer = session.answer(hello, state.record, state.now)
        who = f"controller {hello.instance}"
        match answer:
            case "ask":
                yield state.save()
                yield Publish(session.hello(link))
            case "begin anew" | "begin and ask":
                self._begin_session()
                yield from self._anew(UNKNOWN_THERE, "session ended; new session", "warning")
            case "work":
                self.news.enter("running")
                if session.took_up():
                    yield Notice(f"{who} took up session {session.record.id}")
            case "say whose":
                text = f"speaks up while controller {session.controller} has the session: "
                yield Publish(session.hello(link))
                yield _incompatible(f"{who} {text}two controllers on one loop?")
            case "say model":
                if hello.verdict == "greeting":
                    yield Publish(session.hello(link))
                yield _incompatible(f"{who} has another model, {hello.fingerprint[:8]}; ignored")
            case "give up":
                detail = (
                    f"the controller's model is {hello.fingerprint[:8]}, "
                    f"this plant's is {state.rules.fingerprint[:8]}"
                )
                self.news.enter("refused", detail)
                yield Notice(f"{detail}: the two ends must share one scenario", "error")

    def _begin_session(self) -> None:
        self.state.begin_session(self._new_id())
        self.stepper.forget()

    def _anew(self, why: str, notice: str, level: Literal["warning", "error"]) -> Effects:
        """Tell of a new session, save it, and say hello."""
        state = self.state
        self.news.enter("greeting")
        session = state.session.record.id
        yield Tell(SessionBegan(session, why))
        yield state.save()
        yield Publish(state.session.hello(state.link))
        yield Notice(f"{notice} {session}", level)


def _incompatible(text: str) -> Notice:
    return Notice(text, "warning", "incompatible")
