"""The link as a rule-based state machine: hypothesis plays the network and the reaper.

Messages lie in a bag from which any may be delivered at any time, again and again, or never; any
process may be killed between any two events, or between saving and sending, and may come back with
or without its journal. A second controller, with a journal of its own, may work on the same loop.
The property of the protocol is checked after every rule.
"""

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from protocol.link.receiver import Receiver, ReceiverRecord
from protocol.link.sender import Sender, SenderEffects, SenderRecord
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from tests.support.line_plant import line_rules

RULES = line_rules(alpha=4.0, largest_input=1e9)
PAYLOADS = ((b"a", b"bc"), (b"d", b"ef"))
SHIFTS = (1.5, 1.25)
"""What each controller sends, and how far its candidates are from the middle."""
DEATHS = ["", "", "", "", "", "saving", "sending", "counting"]
"""Before what of an event a process dies, if it does."""
MEMORY = 12
"""Messages that the network keeps: its memory is long, but not endless."""

Move = tuple[Offer, int, tuple[float, ...]]


class Outbox:
    def __init__(self, payloads: tuple[bytes, ...]) -> None:
        self.payloads = payloads

    def payload(self, number: int) -> bytes | None:
        return self.payloads[number] if number < len(self.payloads) else None


class Chosen:
    """Random symbols as hypothesis wants them."""

    def __init__(self) -> None:
        self.next = 0

    def symbol(self, transition: int, size: int) -> int:
        self.next = (self.next * 5 + 3) % 17
        return self.next % size


class Controller:
    """A controller and its journal: the record last saved, and the step that followed it."""

    def __init__(self, number: int) -> None:
        self.outbox = Outbox(PAYLOADS[number])
        self.shift = SHIFTS[number]
        self.disk: tuple[SenderRecord | None, tuple[Measurement, Offer] | None] = (None, None)
        self.sender: Sender


class Link(RuleBasedStateMachine):
    controllers = 1

    def __init__(self) -> None:
        super().__init__()
        self.names = 0
        self.fresh = Chosen()
        self.to_plant: list[Offer | ControllerHello] = []
        self.to_controller: list[Measurement | PlantHello] = []
        self.each = [Controller(number) for number in range(self.controllers)]
        self.plant_disk: tuple[ReceiverRecord, str, Move | None] | None = None
        self.sent: dict[tuple[str, int], object] = {}
        self.got: dict[tuple[str, int], object] = {}
        self.ciphers: dict[tuple[str, int], tuple[int, int]] = {}
        self.inbox: list[bytes] = []
        self.forgot = (
            self.controllers > 1
        )  # one takes over from the other before it knows of a frame
        for controller in self.each:
            self.start_controller(controller)
        self.start_plant()

    def name(self) -> str:
        self.names += 1
        return f"{self.names:016x}"

    def start_controller(self, one: Controller) -> None:
        def propose(x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
            return ((-x[0] - one.shift,), (-x[0] + one.shift,))

        one.sender = Sender(RULES, propose, one.outbox, self.fresh, self.name(), *one.disk)
        if one.sender.unsettled:
            self.save_controller(one, one.sender.settle())
        self.to_plant.append(one.sender.greeting())

    def draw_controller(self, data: st.DataObject) -> Controller:
        return data.draw(st.sampled_from(self.each))

    def start_plant(self) -> None:
        if self.plant_disk is None:
            record = ReceiverRecord(session=self.name(), k=0, x=(0.0,), u=(0.0,))
            self.plant_disk = (record, "", None)
        record, chunks, move = self.plant_disk
        self.receiver = Receiver(RULES, self.name(), record, chunks)
        if move is not None:
            self.count(*move)

    # --- the plant's own moves ---------------------------------------------------------------

    @rule()
    def plant_greets(self) -> None:
        self.to_controller.append(self.receiver.hello())

    @precondition(lambda self: self.receiver.accepted)
    @rule()
    def plant_measures(self) -> None:
        self.to_controller.append(self.receiver.measurement())

    @rule()
    def controller_was_silent(self) -> None:
        self.receiver.look_around()

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
    @rule(data=st.data(), dies=st.sampled_from(DEATHS), running=st.booleans())
    def controller_hears(self, data: st.DataObject, dies: str, running: bool) -> None:
        message = data.draw(st.sampled_from(self.to_controller))
        self.tell_controller(self.draw_controller(data), message, dies, running=running)
        del self.to_controller[:-MEMORY]

    def tell_controller(
        self,
        one: Controller,
        message: Measurement | PlantHello,
        dies: str = "",
        *,
        running: bool = False,
    ) -> None:
        if isinstance(message, Measurement):
            effects = self.measured(one, message, dies)
        else:
            effects = one.sender.heard_plant(message, running=running)
        if dies != "saving":
            self.save_controller(one, effects)
        if dies not in ("saving", "sending"):
            self.send_controller(one, effects)
        if dies:
            self.start_controller(one)

    def measured(self, one: Controller, message: Measurement, dies: str = "") -> SenderEffects:
        """The controller hears a measurement; it saves a step before it has settled it."""
        effects = one.sender.measured(message)
        if effects.append:
            assert effects.offer is not None
            if dies != "saving":
                one.disk = (one.sender.record, (message, effects.offer))
            settled = one.sender.settle()
            if not dies:
                self.save_controller(one, settled)
        return effects

    def save_controller(self, one: Controller, effects: SenderEffects) -> None:
        if effects.save:
            one.disk = (one.sender.record, None)
        if effects.transition is not None:
            t = effects.transition
            self.sent[t.session, t.j] = t

    def send_controller(self, one: Controller, effects: SenderEffects) -> None:
        if effects.offer is not None:
            record = one.sender.record
            at = (effects.offer.session, record.transitions)
            first = self.ciphers.setdefault(at, (record.s, effects.offer.cipher))
            if record.s == 2:
                assert first == (2, effects.offer.cipher), "a key served two cipher symbols"
            self.to_plant.append(effects.offer)
        if effects.reply is not None:
            self.to_plant.append(effects.reply)
        if effects.greet:
            self.to_plant.append(one.sender.greeting())

    @precondition(lambda self: self.to_plant)
    @rule(
        data=st.data(),
        coin=st.integers(0, 1),
        d=st.floats(-1, 1),
        dies=st.sampled_from(DEATHS),
    )
    def plant_hears(self, data: st.DataObject, coin: int, d: float, dies: str) -> None:
        self.tell_plant(data.draw(st.sampled_from(self.to_plant)), coin, d, dies)
        del self.to_plant[:-MEMORY]

    def tell_plant(
        self, message: Offer | ControllerHello, coin: int, d: float, dies: str = ""
    ) -> None:
        if isinstance(message, ControllerHello):
            outcome = self.receiver.heard_controller(message, self.name())
            assert outcome not in ("refused", "stranger")
            if outcome in ("ended", "greet") and dies != "saving":
                self.save_plant(drop_chunks=outcome == "ended")
            if outcome in ("ended", "greet", "rival") and not dies:
                self.to_controller.append(self.receiver.hello())
        elif self.receiver.check(message) == "current":
            x = self.receiver.record.x[0]
            u = message.candidates[coin][0]
            self.apply(message, coin, (x + u + d,), dies)
        if dies:
            self.start_plant()

    @rule(first=st.integers(0, 1))
    def all_is_well_for_a_while(self, first: int) -> None:
        """Everybody hears everything at once, so that runs get far enough to be interesting."""
        heard_before = self.to_controller, self.to_plant
        self.to_controller, self.to_plant = [], []
        if not self.receiver.accepted:
            self.receiver.look_around()
        for _ in range(20):
            if self.to_plant:
                heard_before[1].append(self.to_plant.pop(0))
                self.tell_plant(heard_before[1][-1], self.receiver.record.k % 2, 0.3)
                continue
            if not self.to_controller:
                receiver = self.receiver
                self.to_controller.append(
                    receiver.measurement() if receiver.accepted else receiver.hello()
                )
            heard_before[0].append(self.to_controller.pop(0))
            for one in self.each[first:] + self.each[:first]:
                self.tell_controller(one, heard_before[0][-1])
        self.to_controller = [*heard_before[0], *self.to_controller]
        self.to_plant = [*heard_before[1], *self.to_plant]

    # --- the reaper ----------------------------------------------------------------------------

    @rule(data=st.data())
    def controller_is_killed(self, data: st.DataObject) -> None:
        self.start_controller(self.draw_controller(data))

    @rule()
    def plant_is_killed(self) -> None:
        self.start_plant()

    @rule(data=st.data(), which=st.sampled_from(["controller", "plant"]))
    def a_journal_is_lost(self, data: st.DataObject, which: str) -> None:
        self.forgot = True
        if which == "controller":
            one = self.draw_controller(data)
            one.disk = (None, None)
            self.start_controller(one)
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
        sent = sum(PAYLOADS[: self.controllers], ())
        assert set(self.inbox) <= set(sent)
        for payloads in PAYLOADS:
            place = 0
            for payload in (p for p in self.inbox if p in payloads):
                if place < len(payloads) and payload == payloads[place]:
                    place += 1
                else:
                    assert self.forgot
                    assert payload in payloads[:place]


class TwoControllers(Link):
    """A second controller, with a journal of its own, on the same loop."""

    controllers = 2


TestLink = Link.TestCase
TestTwoControllers = TwoControllers.TestCase
TestLink.settings = TestTwoControllers.settings = settings(
    max_examples=60,
    stateful_step_count=60,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
