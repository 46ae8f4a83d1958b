"""The link as a rule-based state machine: hypothesis plays the clock, the network and the reaper.

The endpoints are the services', and so is :func:`runtime.perform.perform`. Messages lie in a
bag from which any may be delivered at any time, again and again, or never. Any process may be
killed between any two events or within one, before it writes, publishes or traces, and may come
back with or without its journal. A second controller, with a journal of its own, may work on the
same loop. The property of the protocol is checked after every rule.
"""

from collections.abc import Callable
from functools import partial
from typing import ClassVar

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from protocol.agreement import NO_SYMBOL
from protocol.link.events import Event, FrameRefused, SessionBegan
from protocol.link.peer import Actions, Save, Write
from protocol.link.session import CountedTransition
from protocol.messages import ControllerHello, Offer, PlantHello
from protocol.schemes.pipelined import Pipelined
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal
from runtime.perform import Crashed, CrashingPorts, CrashPoint, perform
from tests.support.acting_line import ActingLine, LineDevice, acting_plant
from tests.support.line_ends import LinePlant, ToldPorts, line_controller, line_plant
from tests.support.line_plant import line_rules
from tests.support.mail import Mail
from tests.support.twin_journals import TwinControllerJournal, TwinPlantJournal

RULES = line_rules(alpha=4.0, largest_input=1e9)
PIPELINED = line_rules(alpha=16.0, largest_input=1e9, scheme=Pipelined(5))
PAYLOADS = ((b"a", b"bc"), (b"d", b"ef"))
SHIFTS = (1.5, 1.25)
"""What each controller sends, and how far its candidates are from the middle."""
DEATHS: list[CrashPoint | None] = [*[None] * 5, "writing", "publishing", "tracing", "acting"]
"""Before what of an event a process dies, if it does."""
MEMORY = 12
"""Messages that the network keeps: its memory is long, but not endless."""


class Chosen:
    """Random symbols as hypothesis wants them."""

    def __init__(self) -> None:
        self.next = 0

    def symbol(self, transition: int, size: int) -> int:
        self.next = (self.next * 5 + 3) % 17
        return self.next % size


class PlantPorts(ToldPorts):
    """The plant's; what it ever received is known to the test, whatever its journal forgets."""

    def __init__(self, link: "Link") -> None:
        super().__init__(link.plant_journal, link.to_controller.append, link.plant_counted)
        self.ever = link.ever

    def write(self, write: Write) -> None:
        super().write(write)
        if isinstance(write, Save) and write.received is not None:
            self.ever.append(write.received)


class Controller:
    """A controller's life, its journal, and the offers not yet known to be for a transition."""

    def __init__(self, number: int, link: "Link") -> None:
        self.shift = SHIFTS[number]
        self.journal = link.controller_journal(*PAYLOADS[number])
        self.ports = CrashingPorts(ToldPorts(self.journal, self.said, link.counted))
        self.endpoint: ControllerCore
        self.offered: list[Offer] = []
        self.link = link

    def propose(self, x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
        M = self.link.shared.size
        return tuple((-x[0] + (2 * i - M + 1) * self.shift,) for i in range(M))

    def said(self, message: Mail) -> None:
        if message.kind is Offer:
            self.offered.append(Offer.model_validate_json(message.payload))
        self.link.to_plant.append(message)


class Link(RuleBasedStateMachine):
    controllers = 1
    shared = RULES
    step_s: ClassVar[float | None] = None
    controller_journal = MemoryControllerJournal
    plants_journal = MemoryPlantJournal
    acts = False
    plant: PlantCore
    line: LinePlant | ActingLine

    def __init__(self) -> None:
        super().__init__()
        self.names = 0
        self.now = 0.0
        self.fresh = Chosen()
        self.to_plant: list[Mail] = []
        self.to_controller: list[Mail] = []
        self.sent: dict[tuple[str, int], object] = {}
        self.got: dict[tuple[str, int], object] = {}
        self.ciphers: dict[tuple[str, int], int] = {}
        self.forgot = (
            self.controllers > 1
        )  # one takes over from the other before it knows of a frame
        self.late_hello = False  # a hello of a former incarnation of the plant may end a session
        self.ever: list[bytes] = []
        self.plant_journal = self.plants_journal()
        self.plant_ports = CrashingPorts(PlantPorts(self))
        self.device = LineDevice()
        self.device.passes = self.plant_ports.passes
        self.started = True  # the plant's process counts what the one before it left
        self.each = [Controller(number, self) for number in range(self.controllers)]
        for controller in self.each:
            self.start_controller(controller)
        self.start_plant()

    def name(self) -> str:
        self.names += 1
        return f"{self.names:016x}"

    def plant_counted(self, event: Event) -> None:
        if self.acts:
            self.device.look(event, alive=not self.started)
        if isinstance(event, CountedTransition):
            session = self.plant.record.session
            assert event.session == session, "a step counts in another session"
        self.counted(event)

    def counted(self, event: Event) -> None:
        assert not isinstance(event, FrameRefused)
        if isinstance(event, CountedTransition) and event.coin != NO_SYMBOL:
            t = event.shared
            assert self.got.setdefault((t.session, t.j), t) == t, "a transition was counted anew"
        elif isinstance(event, SessionBegan) and event.session is not None:
            grown = any(session != event.session for session, _ in self.got)
            excused = self.forgot or self.late_hello
            assert excused or not grown, "a session ended with both journals there"
        elif isinstance(event, CountedTransition):
            self.sent[event.session, event.j] = event

    # --- lives ---------------------------------------------------------------------------------

    def start_controller(self, one: Controller) -> None:
        one.endpoint = line_controller(
            self.shared, one.propose, one.journal, self.fresh, self.name()
        )
        self.controller_does(one, one.endpoint.start(self.now))

    def start_plant(self) -> None:
        self.plant_ports.crash_at()
        common = self.name, self.name(), self.now, self.step_s
        if self.acts:
            self.plant, self.line = acting_plant(
                self.shared, self.plant_journal, self.device, *common
            )
        else:
            self.plant, self.line = line_plant(self.shared, self.plant_journal, *common)
        self.started = True
        self.plant_does(self.plant.start)
        self.started = False

    def controller_does(
        self, one: Controller, actions: Actions, dies: CrashPoint | None = None
    ) -> None:
        one.ports.crash_at(before=dies)
        try:
            perform(actions, one.endpoint, one.ports)
        except Crashed:
            self.start_controller(one)
            return
        record = one.endpoint.record
        for offer in one.offered:
            if offer == record.offer:
                at = (offer.session, record.transitions)
                first = self.ciphers.setdefault(at, offer.cipher)
                assert first == offer.cipher, "a transition was offered two cipher symbols"
        one.offered.clear()
        if dies is not None:
            self.start_controller(one)

    def plant_does(self, act: Callable[[float], Actions], dies: CrashPoint | None = None) -> None:
        self.plant_ports.crash_at(before=dies)
        try:
            perform(act(self.now), self.plant, self.plant_ports)
        except Crashed:
            self.start_plant()
            return
        if dies is not None:
            self.start_plant()

    # --- the clock -----------------------------------------------------------------------------

    @rule(
        seconds=st.sampled_from([0.001, 0.03, 0.06, 0.15, 2.5]),
        d=st.floats(-1, 1),
        dies=st.sampled_from(DEATHS),
    )
    def time_passes(self, seconds: float, d: float, dies: CrashPoint | None) -> None:
        """Hellos, measurements, repeats, missed steps, silence."""
        self.now += seconds
        self.line.d = d
        if self.plant.wake_at() <= self.now:
            self.plant_does(self.plant.wake, dies)

    # --- the network ---------------------------------------------------------------------------

    @precondition(lambda self: self.to_controller)
    @rule(data=st.data(), dies=st.sampled_from(DEATHS))
    def controller_hears(self, data: st.DataObject, dies: CrashPoint | None) -> None:
        message = data.draw(st.sampled_from(self.to_controller))
        self.tell_controller(data.draw(st.sampled_from(self.each)), message, dies)
        del self.to_controller[:-MEMORY]

    def tell_controller(
        self, one: Controller, message: Mail, dies: CrashPoint | None = None
    ) -> None:
        if message.kind is PlantHello:
            hello = PlantHello.model_validate_json(message.payload)
            self.late_hello |= hello.instance != self.plant.instance
        self.controller_does(one, one.endpoint.receive(*message, self.now), dies)

    @precondition(lambda self: self.to_plant)
    @rule(
        data=st.data(),
        drawn=st.integers(0, 29),
        d=st.floats(-1, 1),
        dies=st.sampled_from(DEATHS),
    )
    def plant_hears(
        self, data: st.DataObject, drawn: int, d: float, dies: CrashPoint | None
    ) -> None:
        coin = drawn % self.shared.size
        self.tell_plant(data.draw(st.sampled_from(self.to_plant)), coin, d, dies)
        del self.to_plant[:-MEMORY]

    def tell_plant(
        self, message: Mail, coin: int, d: float, dies: CrashPoint | None = None
    ) -> None:
        self.line.coin, self.line.d = coin, d
        self.plant_does(partial(self.plant.receive, *message), dies)
        assert not self.plant.refused

    @rule(first=st.integers(0, 1))
    def all_is_well_for_a_while(self, first: int) -> None:
        """Everybody hears everything at once, so that runs get far enough to be interesting."""
        before = self.to_controller[:], self.to_plant[:]
        self.to_controller.clear()
        self.to_plant.clear()
        if not self.plant.accepted:
            self.now += 2.5
        for _ in range(30):
            if self.to_plant:
                before[1].append(self.to_plant.pop(0))
                k = self.plant.record.k
                self.tell_plant(before[1][-1], k % self.shared.size, 0.3)
            elif self.to_controller:
                before[0].append(self.to_controller.pop(0))
                for one in self.each[first:] + self.each[:first]:
                    self.tell_controller(one, before[0][-1])
            else:
                self.now = max(self.now, self.plant.wake_at())
                self.plant_does(self.plant.wake)
        self.to_controller[:0] = before[0]
        self.to_plant[:0] = before[1]

    # --- the reaper ----------------------------------------------------------------------------

    @rule(data=st.data())
    def controller_is_killed(self, data: st.DataObject) -> None:
        self.start_controller(data.draw(st.sampled_from(self.each)))

    @rule()
    def plant_is_killed(self) -> None:
        self.start_plant()

    @rule(data=st.data(), which=st.sampled_from(["controller", "plant"]))
    def a_journal_is_lost(self, data: st.DataObject, which: str) -> None:
        self.forgot = True
        if which == "controller":
            one = data.draw(st.sampled_from(self.each))
            one.journal.forget()
            self.start_controller(one)
        else:
            self.plant_journal.forget()
            self.device.u = None  # what it was told is known to nobody any more
            self.start_plant()

    @precondition(lambda self: self.plant.controller is not None)
    @rule(dies=st.sampled_from(DEATHS))
    def the_controller_knows_no_session(self, dies: CrashPoint | None) -> None:
        """As one does that was misled: whatever the plant is doing, its session is over."""
        self.forgot = True
        receiver = self.plant
        word = ControllerHello(
            instance=receiver.controller or "",
            incarnation=receiver.record.incarnation,
            fingerprint=self.shared.fingerprint,
            verdict="unknown-session",
            session=receiver.record.session,
            answers=receiver.instance,
        )
        self.plant_does(partial(self.plant.receive, ControllerHello, word.wire()), dies)

    # --- the property --------------------------------------------------------------------------

    @invariant()
    def both_agree_on_what_both_counted(self) -> None:
        for at in self.sent.keys() & self.got.keys():
            assert self.sent[at] == self.got[at]

    @invariant()
    def messages_arrive_in_order_and_once(self) -> None:
        inbox = self.ever
        sent = sum(PAYLOADS[: self.controllers], ())
        assert set(inbox) <= set(sent)
        for payloads in PAYLOADS:
            place = 0
            for payload in (p for p in inbox if p in payloads):
                if place < len(payloads) and payload == payloads[place]:
                    place += 1
                else:
                    assert self.forgot
                    assert payload in payloads[:place]


class Deadlines(Link):
    """Each step takes its time, and a step without an offer is missed."""

    step_s: ClassVar[float | None] = 0.1


class Acting(Deadlines):
    """A device: a step is begun and read at its end, and its session may end in between."""

    acts = True
    controllers = 2


class ActingOnDisk(Acting):
    """The same with the services' journals."""

    controller_journal = TwinControllerJournal
    plants_journal = TwinPlantJournal

    def teardown(self) -> None:
        closed(self)


class ActingAtOnce(Acting):
    """The same in lock-step: read as soon as it was actuated."""

    step_s = None


def closed(link: Link) -> None:
    """Remove a machine's journals on disk."""
    for journal in (link.plant_journal, *(one.journal for one in link.each)):
        assert isinstance(journal, TwinControllerJournal | TwinPlantJournal)
        journal.close()


class TwoControllers(Deadlines):
    """A second controller, with a journal of its own, on the same loop."""

    controllers = 2


class OnDisk(TwoControllers):
    """Journals as the services have them, opened anew from their files after each death."""

    controller_journal = TwinControllerJournal
    plants_journal = TwinPlantJournal

    def teardown(self) -> None:
        closed(self)


class PipelinedLink(Deadlines):
    """Five candidates that every transition tells apart, and a symbol in every transition."""

    shared = PIPELINED

    @invariant()
    def every_key_serves_the_next_transition(self) -> None:
        for (session, j), t in self.got.items():
            assert isinstance(t, CountedTransition)
            assert t.symbol >= 0
            before = self.got.get((session, j - 1))
            if isinstance(before, CountedTransition):
                assert (t.role, t.key) == ("message", before.symbol)
            elif j == 0:
                assert t.role == "test"


TestLink = Link.TestCase
TestDeadlines = Deadlines.TestCase
TestTwoControllers = pytest.mark.slow(TwoControllers.TestCase)
TestPipelinedLink = pytest.mark.slow(PipelinedLink.TestCase)
TestLink.settings = TestDeadlines.settings = TestTwoControllers.settings = settings(
    max_examples=40,
    stateful_step_count=60,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestPipelinedLink.settings = TestLink.settings
TestOnDisk = pytest.mark.slow(OnDisk.TestCase)
TestOnDisk.settings = settings(TestLink.settings, max_examples=12)
TestActing = Acting.TestCase
TestActingAtOnce = pytest.mark.slow(ActingAtOnce.TestCase)
TestActing.settings = TestActingAtOnce.settings = TestLink.settings
TestActingOnDisk = pytest.mark.slow(ActingOnDisk.TestCase)
TestActingOnDisk.settings = TestOnDisk.settings
