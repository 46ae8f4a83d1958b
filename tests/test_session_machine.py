"""The link as a rule-based state machine: hypothesis plays the network and the reaper.

Messages lie in a bag from which any may be delivered at any time, again and again, or never; either
process may be killed between any two events, or between saving and sending, and may come back with
or without its journal. The property of the protocol is checked after every rule.
"""

from collections.abc import Callable

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from protocol.agreement import AgreementRule, Gauge
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from protocol.receiver import Receiver, ReceiverRecord
from protocol.sender import Sender, SenderEffects, SenderRecord
from protocol.session import Rules

RULES = Rules(
    agreement=AgreementRule(A=((1.0,),), B=((1.0,),), gauge=Gauge(half_widths=(1.0,)), alpha=4.0),
    size=2,
    states=1,
    inputs=1,
    fingerprint="f" * 64,
)
PAYLOADS = (b"a", b"bc")
DEATHS = ["", "", "", "", "", "saving", "sending", "counting"]
"""Before what of an event a process dies, if it does."""

Move = tuple[Offer, int, tuple[float, ...]]


class Outbox:
    def payload(self, number: int) -> bytes | None:
        return PAYLOADS[number] if number < len(PAYLOADS) else None


class Chosen:
    """Random symbols as hypothesis wants them."""

    def __init__(self) -> None:
        self.next = 0

    def symbol(self, transition: int, size: int) -> int:
        self.next = (self.next * 5 + 3) % 17
        return self.next % size


class Link(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.names = 0
        self.fresh = Chosen()
        self.to_plant: list[Offer | ControllerHello] = []
        self.to_controller: list[Measurement | PlantHello] = []
        self.controller_disk: tuple[SenderRecord | None, tuple[Measurement, Offer] | None]
        self.controller_disk = (None, None)
        self.plant_disk: tuple[ReceiverRecord, str, Move | None] | None = None
        self.sent: dict[tuple[str, int], object] = {}
        self.got: dict[tuple[str, int], object] = {}
        self.ciphers: dict[tuple[str, int], tuple[int, int]] = {}
        self.inbox: list[bytes] = []
        self.forgot = False
        self.start_controller()
        self.start_plant()

    def name(self) -> str:
        self.names += 1
        return f"{self.names:016x}"

    def start_controller(self) -> None:
        def propose(x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
            return ((-x[0] - 1.5,), (-x[0] + 1.5,))

        self.sender = Sender(
            RULES, propose, Outbox(), self.fresh, self.name(), *self.controller_disk
        )
        if self.sender.unsettled:
            self.save_controller(self.sender.settle())
        self.to_controller_hears(self.sender.greeting)

    def to_controller_hears(self, greeting: Callable[[], ControllerHello]) -> None:
        self.to_plant.append(greeting())

    def start_plant(self) -> None:
        if self.plant_disk is None:
            record = ReceiverRecord(session=self.name(), k=0, x=(0.0,), u=(0.0,))
            self.plant_disk = (record, "", None)
        record, chunks, move = self.plant_disk
        self.receiver = Receiver(RULES, self.name(), record, chunks)
        if move is not None:
            self.count(*move)

    def keep(self, bag: list[object]) -> None:
        """A network's memory is long, but not endless."""
        del bag[:-12]

    # --- the plant's own moves ---------------------------------------------------------------

    @rule()
    def plant_greets(self) -> None:
        self.to_controller.append(self.receiver.hello())

    @precondition(lambda self: self.receiver.accepted)
    @rule()
    def plant_measures(self) -> None:
        self.to_controller.append(self.receiver.measurement())

    @rule()
    def plant_misses(self) -> None:
        record = self.receiver.record
        self.receiver.missed(record.u, (record.x[0] + 0.25,))
        self.save_plant()

    def save_plant(self, chunk: str = "", *, drop_chunks: bool = False) -> None:
        assert self.plant_disk is not None
        chunks = "" if drop_chunks else self.plant_disk[1]
        self.plant_disk = (self.receiver.record, chunks + chunk, None)

    def apply(self, offer: Offer, coin: int, x_next: tuple[float, ...], dies: str = "") -> None:
        """The plant made a step: it saves that, reports it, and counts it."""
        if dies != "saving":
            assert self.plant_disk is not None
            self.plant_disk = (self.receiver.record, self.plant_disk[1], (offer, coin, x_next))
            if dies != "sending":
                self.to_controller.append(self.receiver.moved(x_next))
                if dies != "counting":
                    self.count(offer, coin, x_next)

    def count(self, offer: Offer, coin: int, x_next: tuple[float, ...]) -> None:
        reported = self.receiver.moved(x_next)
        effects = self.receiver.applied(offer, coin, x_next)
        assert self.receiver.measurement() == reported
        t = effects.transition
        self.got[t.session, t.j] = t
        frame = effects.frame
        if frame is not None:
            assert frame.intact
            self.inbox.append(frame.payload)
        if effects.chunk or frame is not None:
            self.save_plant(effects.chunk, drop_chunks=frame is not None)

    # --- the network ---------------------------------------------------------------------------

    @precondition(lambda self: self.to_controller)
    @rule(data=st.data(), dies=st.sampled_from(DEATHS))
    def controller_hears(self, data: st.DataObject, dies: str) -> None:
        place = data.draw(st.integers(0, len(self.to_controller) - 1))
        message = self.to_controller[place]
        if isinstance(message, Measurement):
            effects = self.measured(message, dies)
        else:
            effects = self.sender.heard_plant(message)
        if dies != "saving":
            self.save_controller(effects)
        if dies not in ("saving", "sending"):
            self.send_controller(effects)
        if dies:
            self.start_controller()
        self.keep(self.to_controller)  # type: ignore[arg-type]

    def measured(self, message: Measurement, dies: str = "") -> SenderEffects:
        """The controller hears a measurement; it saves a step before it has settled it."""
        effects = self.sender.measured(message)
        if effects.append:
            assert effects.offer is not None
            if dies != "saving":
                self.controller_disk = (self.sender.record, (message, effects.offer))
            settled = self.sender.settle()
            if not dies:
                self.save_controller(settled)
        return effects

    def save_controller(self, effects: SenderEffects) -> None:
        if effects.save:
            self.controller_disk = (self.sender.record, None)
        if effects.transition is not None:
            t = effects.transition
            self.sent[t.session, t.j] = t

    def send_controller(self, effects: SenderEffects) -> None:
        if effects.offer is not None:
            record = self.sender.record
            at = (effects.offer.session, record.transitions)
            first = self.ciphers.setdefault(at, (record.s, effects.offer.cipher))
            if record.s == 2:
                assert first == (2, effects.offer.cipher), "a key served two cipher symbols"
            self.to_plant.append(effects.offer)
        if effects.reply is not None:
            self.to_plant.append(effects.reply)
        if effects.greet:
            self.to_plant.append(self.sender.greeting())

    @precondition(lambda self: self.to_plant)
    @rule(
        data=st.data(),
        coin=st.integers(0, 1),
        d=st.floats(-1, 1),
        dies=st.sampled_from(DEATHS),
    )
    def plant_hears(self, data: st.DataObject, coin: int, d: float, dies: str) -> None:
        place = data.draw(st.integers(0, len(self.to_plant) - 1))
        message = self.to_plant[place]
        if isinstance(message, ControllerHello):
            outcome = self.receiver.heard_controller(message, self.name())
            assert outcome != "refused"
            if outcome == "ended" and dies != "saving":
                self.save_plant(drop_chunks=True)
            if outcome in ("ended", "greet") and not dies:
                self.to_controller.append(self.receiver.hello())
        elif self.receiver.check(message) == "current":
            x = self.receiver.record.x[0]
            u = message.candidates[coin][0]
            self.apply(message, coin, (x + u + d,), dies)
        if dies:
            self.start_plant()
        self.keep(self.to_plant)  # type: ignore[arg-type]

    @rule()
    def all_is_well_for_a_while(self) -> None:
        """Some steps without trouble, so that runs get far enough to be interesting."""
        for _ in range(6):
            if not self.receiver.accepted:
                effects = self.sender.heard_plant(self.receiver.hello())
                self.save_controller(effects)
                assert effects.reply is not None
                if self.receiver.heard_controller(effects.reply, self.name()) == "ended":
                    self.save_plant(drop_chunks=True)
                continue
            effects = self.measured(self.receiver.measurement())
            self.save_controller(effects)
            self.send_controller(effects)
            if effects.offer is None:
                self.receiver.heard_controller(self.sender.greeting(), self.name())
                effects = self.sender.heard_plant(self.receiver.hello())
                self.save_controller(effects)
                assert effects.reply is not None
                if self.receiver.heard_controller(effects.reply, self.name()) == "ended":
                    self.save_plant(drop_chunks=True)
                continue
            if self.receiver.check(effects.offer) != "current":
                continue
            record = self.receiver.record
            coin = record.k % 2
            self.apply(
                effects.offer, coin, (record.x[0] + effects.offer.candidates[coin][0] + 0.3,)
            )

    # --- the reaper ----------------------------------------------------------------------------

    @rule()
    def controller_is_killed(self) -> None:
        self.start_controller()

    @rule()
    def plant_is_killed(self) -> None:
        self.start_plant()

    @rule(which=st.sampled_from(["controller", "plant"]))
    def a_journal_is_lost(self, which: str) -> None:
        self.forgot = True
        if which == "controller":
            self.controller_disk = (None, None)
            self.start_controller()
        else:
            self.plant_disk = None
            self.start_plant()

    # --- the property --------------------------------------------------------------------------

    @invariant()
    def both_agree_on_what_both_counted(self) -> None:
        for at in self.sent.keys() & self.got.keys():
            assert self.sent[at] == self.got[at]

    @invariant()
    def messages_arrive_in_order_and_once(self) -> None:
        place = 0
        for payload in self.inbox:
            if place < len(PAYLOADS) and payload == PAYLOADS[place]:
                place += 1
            else:
                assert self.forgot
                assert payload in PAYLOADS[:place]


TestLink = Link.TestCase
TestLink.settings = settings(
    max_examples=60,
    stateful_step_count=60,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
