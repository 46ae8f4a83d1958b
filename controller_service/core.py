"""The controller's end of the link, sans I/O: which machine is asked about a message, and when.

The rules are those of :mod:`protocol.link.session`. Which plant's session is served stands in
:mod:`protocol.link.controller_session`, a step in :mod:`controller_service.chooser`.
"""

from collections.abc import Callable
from math import inf
from typing import ClassVar, Final, Literal

from controller_service import alarms
from controller_service.chooser import HALTED, Chooser, Predict
from controller_service.outbox import MessageQueue, Outbox
from controller_service.state import ControllerState
from controller_service.telemetry import ControllerTelemetry
from protocol.link.channel import Channel
from protocol.link.effects import Effects, Extract, Notice, Publish, Tell
from protocol.link.endpoint import Endpoint
from protocol.link.events import (
    BLOCKS_DIFFER,
    DOES_NOT_FOLLOW,
    ELSEWHERE,
    FELL_BACK,
    MET,
    PowerFailed,
    SessionBegan,
)
from protocol.link.records import ControllerRecord, Loaded
from protocol.link.session import Rules
from protocol.link.step import IDLE, Answered
from protocol.messages import (
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
from protocol.secret.nonces import NonceSource
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import USAGE

NEW: Final = Loaded[ControllerRecord]()
"""A journal that nothing was saved in."""


class ControllerCore(Endpoint):
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
    news : ControllerTelemetry, optional
        What is told beside the record; without it no status is published.
    nonces : NonceSource
    channel : Channel, optional
        What measurements pass before they arrive.

    Attributes
    ----------
    state : ControllerState
    chooser : Chooser
    """

    receives: ClassVar[tuple[type[Message], ...]] = (Measurement, PlantHello, SendCommand, StopKeys)
    sends: ClassVar[tuple[type[Message], ...]] = (
        Offer,
        ControllerHello,
        SendReply,
        ControllerStatus,
    )

    state: ControllerState
    news: ControllerTelemetry

    def __init__(
        self,
        rules: Rules,
        propose: Callable[[Vector], tuple[Vector, ...]],
        messages: MessageQueue,
        fresh: SymbolSource,
        *,
        instance: str,
        period_s: float,
        loaded: Loaded[ControllerRecord] = NEW,
        predict: Predict | None = None,
        message: bytes | None = None,
        news: ControllerTelemetry | None = None,
        nonces: NonceSource = fresh_nonce,
        channel: Channel | None = None,
    ) -> None:
        super().__init__(instance, channel)
        self.state = ControllerState(
            rules,
            loaded.record or ControllerRecord(),
            loaded,
            nonces,
            -inf,
            instance,
            period_s,
            messages,
            fresh,
        )
        self.news = ControllerTelemetry() if news is None else news
        self.chooser = Chooser(self.state, self.news, propose, predict)
        self._outbox = Outbox(self.state, messages)
        self._fell_back = loaded.fell_back
        self._first_message = message

    # --- from the first to the last word ----------------------------------------------------------

    def start(self, now: float) -> Effects:
        """Count what a journal left to be counted, queue the first message, and greet."""
        state = self.state
        state.now = now
        self.news.soon(now)
        if self._fell_back:
            yield Tell(PowerFailed())
        if isinstance(state.step, Answered):
            measurement, offer = state.step
            reported = self.chooser.report(measurement, offer.cipher)
            yield from self._counted(self.chooser.count(measurement, offer, reported))
        if self._fell_back and state.session.record.id is not None:
            self._drop_session()
            yield Tell(SessionBegan(None, FELL_BACK))
            yield state.save()
        if self._first_message is not None:
            yield from self._outbox.begin(self._first_message)
        yield state.save()  # first: no other process may greet as this incarnation
        yield Publish(state.session.hello())
        yield from map(Extract, state.keys.tasks())
        if state.alarms.halted:
            yield self.news.refusal(HALTED)

    def stop(self, now: float) -> Effects:
        """The last status."""
        state = self.state
        state.now = now
        self.news.stop()
        self.news.soon(now)
        if state.step is IDLE:  # else digits that have served are erased with the next step
            yield state.save()
        yield from self.publish_status()

    # --- messages ---------------------------------------------------------------------------------

    def hear(self, message: Message, now: float) -> Effects:
        """A measurement, a hello of the plant, or the operator's command."""
        state = self.state
        state.now = now
        match message:
            case Measurement():
                return self._measured(message)
            case PlantHello():
                return self._greeted(message)
            case SendCommand():
                return self._outbox.commanded(message, state.frame.record.message)
            case StopKeys():
                return self._stop_keys(message)
        return ()

    def _measured(self, measurement: Measurement) -> Effects:
        """A measurement: one of another session or another step is answered here."""
        state, session = self.state, self.state.session
        assert state.step is IDLE, "the step before has not been counted"
        if wrong := self.chooser.wrong(measurement):
            return self.reject(wrong)
        if not session.serves(measurement):
            return self._remind() if session.stranger(measurement) == "remind" else ()
        session.plant_at = state.now
        match self.chooser.place(measurement):
            case "next":
                return self._counted(self.chooser.answer(measurement))
            case "repeated":
                assert state.offer is not None
                self.news.enter("running", "")
                return (Publish(state.keys.again(state.offer)),)
            case "diverged":
                text = f"measurement {measurement.k} does not follow from the journal"
                return self._end_session("does not follow", DOES_NOT_FOLLOW, text)
            case "old":
                return ()

    def _counted(self, effects: Effects) -> Effects:
        """A step's effects; the session ends where a key block turns out to differ."""
        yield from effects
        if self.state.keys.unequal:
            yield from self._end_session("blocks differ", BLOCKS_DIFFER, BLOCKS_DIFFER)

    def _stop_keys(self, command: StopKeys) -> Effects:
        """The claim that keys rest on is refuted: no more are made, and no offer has digits."""
        state = self.state
        if state.keys.record.refuted or not state.keys.on:
            return
        state.keys.refute(command.reason)
        self.news.soon(state.now)
        yield state.save(durable=True)
        yield Notice(f"keys stop: {command.reason}", "error")

    # --- time -------------------------------------------------------------------------------------

    def due_at(self) -> float:
        """When the next status is due."""
        return self.news.due_at

    def act(self, now: float) -> Effects:
        """A status, if it is due."""
        self.state.now = now
        return self.publish_status() if self.news.is_due(now, self.instance) else ()

    # --- sessions ---------------------------------------------------------------------------------

    def _greeted(self, hello: PlantHello) -> Effects:
        """The plant spoke on the management bus: do as the table says."""
        state, session, news = self.state, self.state.session, self.news
        what, answer = session.answer(hello, state.record, state.now)
        match answer:
            case "greet":
                yield Publish(session.hello())
            case "catch up and greet":
                yield state.save()
                yield Publish(session.hello())
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
                yield Publish(session.hello("unknown-session", hello))
                yield news.refusal(why)
            case "step back" | "end and step back":
                yield from self._step_back(hello, ends=answer == "end and step back")
            case "log":
                text = f"plant {hello.instance} speaks up while plant {session.plant} runs: "
                yield news.refusal(f"{text}two plants on one loop?")
            case "say model":
                yield Publish(session.hello("other-model", hello))
                yield news.refusal(f"plant {hello.instance} shares another model")
            case "give up":
                yield from self._give_up(hello)

    def _serve(self, hello: PlantHello) -> Effects:
        """Take up a session, the journal's or a new one. A repeated request is answered again."""
        state, session = self.state, self.state.session
        known = (session.plant, session.record.id)
        if hello.session != session.record.id:
            state.alarms = alarms.session_ended(state.rules, state.alarms)
            state.begin_session(hello.session)
            self.chooser.forget()
            yield Tell(SessionBegan(hello.session, MET))
            yield state.save()
        session.plant = hello.instance
        yield Publish(session.hello("accepted", hello))
        if (hello.instance, hello.session) != known:
            self.news.enter("running", "")
            yield Notice(f"session {hello.session} taken up with plant {hello.instance}")

    def _drop_session(self) -> None:
        """Forget the session and its half-agreed key."""
        self.state.session.plant = None
        self.state.begin_session(None)
        self.news.enter("greeting")

    def _end_session(
        self, what: Literal["does not follow", "blocks differ"], why: str, text: str
    ) -> Effects:
        """One of the two ends went back in time: end the session, and greet."""
        state = self.state
        state.session.on(what)
        self._drop_session()
        yield Tell(SessionBegan(None, why))
        yield state.save()
        yield from self._remind()
        yield self.news.refusal(f"{text}; session ended")

    def _step_back(self, hello: PlantHello, *, ends: bool) -> Effects:
        """The plant asks another controller, or is with one: offer nothing in that session."""
        state = self.state
        state.session.plant = None
        self.news.enter("greeting")
        if ends:
            self._drop_session()
            yield Tell(SessionBegan(None, ELSEWHERE))
            yield state.save()
        why = f"plant {hello.instance} is with controller {hello.controller}, and not with "
        yield self.news.refusal(f"{why}this one, {self.instance}")

    def _give_up(self, hello: PlantHello) -> Effects:
        """The only plant shares another model: there is nothing to go on with."""
        state = self.state
        self.code = USAGE
        detail = (
            f"the plant's model is {hello.fingerprint[:8]}, "
            f"this controller's is {state.rules.fingerprint[:8]}"
        )
        yield Publish(state.session.hello("other-model", hello))
        yield self.news.refusal(f"plant {hello.instance} shares another model")
        self.news.enter("refused", detail)
        yield Notice(f"{detail}: the two ends must share one scenario", "error")

    def _remind(self) -> Effects:
        """Greet, but not too often."""
        if self.state.session.may_greet(self.state.now):
            yield Publish(self.state.session.hello())
