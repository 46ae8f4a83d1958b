"""A plant's core alone: the test is its shell and its partner.

Time stands still but where it is asked for: a step ends when an offer was applied, or when it is
missed. What the core traced, saved and published is kept to be looked at.
"""

from collections.abc import Callable, Iterable
from copy import deepcopy
from typing import Any

from plant_service.core import PlantCore
from plant_service.plant import Coin, Plant
from plant_service.status import PlantTelemetry
from protocol.link.distiller import Distiller
from protocol.link.effects import Effects, Extract, Notice, Publish, Save, Tell
from protocol.link.events import Event, Missed, SessionBegan
from protocol.link.pacing import Pacing
from protocol.link.plant_session import HELLO_S
from protocol.link.records import Loaded, PlantRecord
from protocol.link.session import SILENCE_S, CountedTransition, Rules, Truth
from protocol.link.step import IDLE, Idle, Step
from protocol.messages import ControllerHello, Measurement, Message, Offer, PlantHello
from protocol.schemes.framing import Deframer
from protocol.secret.blocks import ClosedBlock
from protocol.secret.nonces import Contribution, NonceSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce

STEP_S = 1e5
"""A step is so long that nothing in it takes any of its time."""

REPEATS = 10**8


class ScriptedLine(Coin):
    """A plant that goes where it is told, by a coin that falls as it is told."""

    acts = device = False
    truth: Truth | None = None

    def __init__(self) -> None:
        self.coin = 0
        self.x_next: Vector = ()
        self.fallback: Vector = ()

    def prepare(self, j: int) -> None:
        pass

    def toss(self, j: int) -> int:
        return self.coin

    def fall_back(self, x: Vector, in_force: Vector) -> Vector:
        return self.fallback

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        pass

    def end(self, k: int) -> Vector:
        return self.x_next

    def safe(self, why: str) -> None:
        pass

    def close(self) -> str:
        return ""


class PlantInHand:
    """A plant process that has read ``record``, and what followed it.

    Parameters
    ----------
    rules, instance
        As of :class:`plant_service.core.PlantCore`.
    record, symbols, contributions, step
        What its journal has.
    fresh : NonceSource
    plant, coin, fallback : optional
        In place of those that do as they are told.
    news : PlantTelemetry, optional
        Statuses are published with it.
    """

    def __init__(
        self,
        rules: Rules,
        instance: str,
        record: PlantRecord,
        symbols: str = "",
        contributions: Iterable[Contribution] = (),
        fresh: NonceSource = fresh_nonce,
        *,
        step: Step = IDLE,
        plant: Plant | None = None,
        coin: Coin | None = None,
        fallback: Callable[[Vector, Vector], Vector] | None = None,
        news: PlantTelemetry | None = None,
    ) -> None:
        self.line = ScriptedLine()
        self.events: list[Event] = []
        self.notices: list[Notice] = []
        self.saved: list[Save] = []
        self.tasks: list[ClosedBlock] = []
        self.step: Save | None = None
        """The step that was saved last, as its journal has it."""
        self.published: list[Message] = []
        self._new = ""
        self._now = 0.0
        self._first: Measurement | None = None
        self.core = PlantCore(
            rules,
            plant or self.line,
            coin or self.line,
            fallback or self.line.fall_back,
            Pacing(STEP_S, REPEATS, 0.0),
            lambda: self._new,
            0.0,
            instance=instance,
            loaded=Loaded(record, step, tuple(contributions), symbols=symbols),
            news=news,
            nonces=fresh,
        )
        self.carry_out(self.core.start(0.0))

    @property
    def record(self) -> PlantRecord:
        return self.core.state.record

    @property
    def accepted(self) -> bool:
        return self.core.state.session.accepted

    @property
    def refused(self) -> bool:
        return self.core.state.session.state == "refused"

    @property
    def controller(self) -> str | None:
        return self.core.state.session.controller

    @property
    def keys(self) -> Distiller:
        return self.core.state.keys

    @property
    def deframer(self) -> Deframer:
        return self.core.state.frame.deframer

    def carry_out(self, effects: Effects) -> None:
        """What `perform` does."""
        for effect in effects:
            match effect:
                case Tell(event):
                    self.events.append(event)
                case Notice():
                    self.notices.append(effect)
                case Publish(message):
                    self.published.append(message)
                case Extract(block):
                    self.tasks.append(block)
                case Save(step=Idle()):
                    self.saved.append(effect)
                case Save():
                    self.step = effect

    def _forget(self) -> None:
        self.events.clear()
        self.notices.clear()
        self.published.clear()
        self.saved.clear()
        self.step = None

    def said(self, kind: type[Message]) -> Any:
        """The last message of a kind that it published, or None."""
        return next((found for found in reversed(self.published) if type(found) is kind), None)

    # --- sessions ---------------------------------------------------------------------------------

    def hear(self, kind: type[Message], payload: bytes) -> None:
        self._forget()
        self.carry_out(self.core.receive(kind, payload, self._now))

    def heard_controller(self, hello: ControllerHello, new_session: str) -> str:
        """What becomes of a controller's hello, by what it does."""
        self._new = new_session
        self.hear(ControllerHello, hello.wire())
        texts = " ".join(notice.text for notice in self.notices)
        if (self.core.state.session.state == "refused") and "must share one scenario" in texts:
            return "refused"
        if "two controllers on one loop?" in texts:
            assert self.said(PlantHello) is not None
            return "competing"
        if "has another model" in texts:
            assert (self.said(PlantHello) is not None) == (hello.verdict == "greeting")
            return "incompatible"
        if any(isinstance(event, SessionBegan) for event in self.events):
            assert self.said(PlantHello).session == new_session
            assert self.saved[-1].record == self.record
            return "ended"
        if self.said(PlantHello) is not None:
            assert self.saved[-1].record == self.record
            return "greet"
        assert not self.saved
        mine = (hello.answers, hello.session) == (self.core.instance, self.record.session.id)
        accepts = mine and hello.verdict == "accepted" and hello.instance == self.controller
        assert not accepts or self.accepted
        return "accepted" if accepts else "nothing"

    def look_around(self) -> None:
        """The controller is silent for long."""
        self.core.state.session.answered_at = self._now - SILENCE_S - 1
        self._wake()

    def hello(self) -> PlantHello:
        """Its hello: at its time while it looks for somebody, or told to who is not asked."""
        if self.accepted and self.core.state.session.state != "silent":
            stranger = ControllerHello(
                instance="0123456789abcdef",
                incarnation=0,
                fingerprint="0" * 64,
                verdict="greeting",
            )
            core = deepcopy(self.core)  # a stranger's greeting leaves nothing behind
            asked = core.receive(ControllerHello, stranger.wire(), self._now)
            said = [effect.message for effect in asked if isinstance(effect, Publish)]
        else:
            silent = self.core.state.session.state in ("silent", "unanswered")
            self.core.state.session.answered_at = self._now - SILENCE_S - 1 if silent else self._now
            self._now += HELLO_S
            self._forget()
            self.carry_out(self.core.wake(self._now))
            said = self.published
        (hello,) = [message for message in said if isinstance(message, PlantHello)]
        return hello

    # --- steps ------------------------------------------------------------------------------------

    def _wake(self) -> None:
        self._forget()
        self.carry_out(self.core.wake(self._now))
        measured = self.said(Measurement)
        if measured is not None:
            self._first = measured

    def _tick(self) -> None:
        """The step is over."""
        self._now = max(self._now, self.core.state.pacing.deadline)
        self.core.state.session.answered_at = self._now
        self._wake()

    def measurement(self) -> Measurement:
        """The next copy of this step's measurement that leaves."""
        record = self.record
        if not self.accepted:  # it publishes none: what it would have to say
            return Measurement(
                session=record.session.id,
                k=record.link.k,
                x=record.link.x,
                applied_k=record.link.applied_k,
                x_after=record.applied.x_after,
            )
        first = self._first
        if first is None or (first.session, first.k) != (record.session.id, record.link.k):
            self._now += 2 * STEP_S / REPEATS
            self.core.state.session.answered_at = self._now
            self._wake()
        assert self._first is not None
        assert self._first.k == self.record.link.k
        made, self._first = self._first, None
        return made

    def check(self, offer: Offer) -> str:
        """What an offer is to it; it stays as it is.

        Raises
        ------
        ValueError
            When it says that the offer is malformed.
        """
        core = deepcopy(self.core)
        core.state.session.answered_at = -1.0
        effect = next(iter(core.receive(Offer, offer.wire(), self._now)), None)
        if isinstance(effect, Notice) and effect.subject == "malformed":
            raise ValueError(effect.text.removesuffix("; ignored"))
        if isinstance(effect, Save):
            return "current"
        return "foreign" if core.state.session.answered_at == -1.0 else "stale"

    def applied(self, offer: Offer, coin: int, x_next: Vector) -> CountedTransition:
        """The offer is applied, and its step is over."""
        self.line.coin, self.line.x_next = coin, x_next
        applied = self.takes(offer)
        assert (applied.coin, applied.u) == (coin, offer.candidates[coin])
        return applied

    def takes(self, offer: Offer) -> CountedTransition:
        """The offer is applied, and its step is over."""
        self._first = None
        self.hear(Offer, offer.wire())
        if self.core.stepper.plant.acts:  # it is read when its step is over
            self._tick()
        (applied,) = [event for event in self.events if isinstance(event, CountedTransition)]
        if not self.core.stepper.plant.acts:
            kept = self.events[:], self.notices[:], self.saved[:], self.step
            self._tick()
            self.events, self.notices, self.saved, self.step = kept
        return applied

    def dies_over(self, offer: Offer, coin: int, x_next: Vector) -> Save:
        """The offer is applied and saved, and the process is dead: what its journal has."""
        self.line.coin, self.line.x_next = coin, x_next
        self._forget()
        effect = next(iter(self.core.receive(Offer, offer.wire(), self._now)))
        assert isinstance(effect, Save)
        assert not isinstance(effect.step, Idle)
        assert effect.step.offer == offer
        self.step = effect
        return effect

    def missed(self, u: Vector, x_next: Vector) -> None:
        """No offer comes in time: ``u`` is in force, and leads to ``x_next``."""
        self.line.fallback, self.line.x_next = u, x_next
        self.miss()

    def miss(self) -> Missed:
        """No offer comes in time."""
        self._first = None
        self._tick()
        (missed,) = [event for event in self.events if isinstance(event, Missed)]
        return missed
