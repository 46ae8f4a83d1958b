"""The link as a rule-based state machine: hypothesis plays the clock, the network and the reaper.

The endpoints are the services', and so is :func:`runtime.perform.perform`. Messages lie in a
bag from which any may be delivered at any time, again and again, or never. Any process may be
killed between any two events or within one, before it writes, publishes or traces, and may come
back with or without its journal. A second controller, with a journal of its own, may work on the
same loop. The property of the protocol is checked after every rule.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from protocol.link.effects import Effects
from protocol.link.events import Event, SessionBegan
from protocol.link.session import Rules
from protocol.messages import Offer, PlantHello
from protocol.schemes.pipelined import Pipelined
from runtime.perform import CrashPoint
from tests.support.line import disowned, line_rules
from tests.support.mail import Mail, mail
from tests.support.pair import MEMORY, LinePair, Name
from tests.support.safety import out_of_order
from tests.support.size import size

RULES = line_rules(alpha=4.0, largest_input=1e9)
PIPELINED = line_rules(alpha=16.0, largest_input=1e9, scheme=Pipelined(5))
PAYLOADS = ((b"a", b"bc"), (b"d", b"ef"))
"""What each controller sends."""
DEATHS: list[CrashPoint | None] = [*[None] * 5, "saving", "publishing", "tracing", "acting"]
"""Before what of an event a process dies, if it does."""


class Ends(LinePair):
    """Ends of which is known whether a session may end.

    Attributes
    ----------
    forgot : bool
        With nobody to blame: a journal was lost, or one controller takes over from another before
        it knows of a frame.
    late_hello : bool
        Whether a hello of a former process of the plant came: it may end a session.
    """

    def __init__(self, rules: Rules, step_s: float | None, **more: Any) -> None:
        self.forgot = more["rivals"] is not None
        self.late_hello = False
        super().__init__(rules, step_s, PAYLOADS[0], **more)

    def do(self, side: Name, act: Callable[[float], Effects]) -> None:
        super().do(side, act)
        if side == "plant":
            assert self.plant.state.session.state != "refused"

    def hear(self, side: Name, message: Mail) -> None:
        if message.kind is PlantHello:
            hello = PlantHello.model_validate_json(message.payload)
            self.late_hello |= hello.instance != self.plant.instance
        super().hear(side, message)

    def traced(self, side: Name, event: Event) -> None:
        super().traced(side, event)
        if isinstance(event, SessionBegan) and event.session is not None:
            grown = any(session != event.session for session, _ in self.counted["plant"])
            excused = self.forgot or self.late_hello
            assert excused or not grown, "a session ended with both journals there"


class Link(RuleBasedStateMachine):
    rival = False
    shared = RULES
    step_s: ClassVar[float | None] = None
    acts = False

    def __init__(self) -> None:
        super().__init__()
        self.ends = Ends(
            self.shared,
            self.step_s,
            rivals=PAYLOADS[1] if self.rival else None,
            acts=self.acts,
        )
        self.controllers: list[Name] = ["controller", "rival"] if self.rival else ["controller"]

    def teardown(self) -> None:
        self.ends.close()

    def dying(self, side: Name, dies: CrashPoint | None, act: Callable[[], None]) -> None:
        """Something happens to an end, and it dies within it, or after it."""
        lives = self.ends.lives[side]
        self.ends.crash_at(side, dies)
        act()
        if dies is not None and lives == self.ends.lives[side]:
            self.ends.die(side)

    # --- the clock -----------------------------------------------------------------------------

    @rule(
        seconds=st.sampled_from([0.001, 0.03, 0.06, 0.15, 2.5]),
        d=st.floats(-1, 1),
        dies=st.sampled_from(DEATHS),
    )
    def time_passes(self, seconds: float, d: float, dies: CrashPoint | None) -> None:
        """Hellos, measurements, repeats, missed steps, silence."""
        self.ends.line.d = d
        self.dying("plant", dies, partial(self.ends.wake, "plant", seconds))

    # --- the network ---------------------------------------------------------------------------

    @precondition(lambda self: self.ends.mail["controller"])
    @rule(data=st.data(), dies=st.sampled_from(DEATHS))
    def controller_hears(self, data: st.DataObject, dies: CrashPoint | None) -> None:
        message = data.draw(st.sampled_from(self.ends.mail["controller"]))
        side = data.draw(st.sampled_from(self.controllers))
        self.dying(side, dies, partial(self.ends.hear, side, message))

    @precondition(lambda self: self.ends.mail["plant"])
    @rule(
        data=st.data(),
        drawn=st.integers(0, 29),
        d=st.floats(-1, 1),
        dies=st.sampled_from(DEATHS),
    )
    def plant_hears(
        self, data: st.DataObject, drawn: int, d: float, dies: CrashPoint | None
    ) -> None:
        self.ends.line.coin, self.ends.line.d = drawn % self.shared.size, d
        message = data.draw(st.sampled_from(self.ends.mail["plant"]))
        self.dying("plant", dies, partial(self.ends.hear, "plant", message))

    @rule(first=st.integers(0, 1))
    def all_is_well_for_a_while(self, first: int) -> None:
        """Everybody hears everything at once, so that runs get far enough to be interesting."""
        ends, mail = self.ends, self.ends.mail
        before = {side: bag[:] for side, bag in mail.items()}
        mail["plant"].clear()
        mail["controller"].clear()
        if not ends.plant.state.session.accepted:
            ends.now += 2.5
        for _ in range(30):
            if mail["plant"]:
                before["plant"].append(mail["plant"].pop(0))
                ends.line.coin = ends.plant.state.record.link.k % self.shared.size
                ends.line.d = 0.3
                ends.hear("plant", before["plant"][-1])
            elif mail["controller"]:
                before["controller"].append(mail["controller"].pop(0))
                for side in self.controllers[first:] + self.controllers[:first]:
                    ends.hear(side, before["controller"][-1])
            else:
                ends.wake("plant", max(0.0, ends.plant.wake_at() - ends.now))
        for side, bag in before.items():
            mail[side][:0] = bag[-MEMORY:]

    # --- the reaper ----------------------------------------------------------------------------

    @rule(data=st.data())
    def controller_is_killed(self, data: st.DataObject) -> None:
        self.ends.die(data.draw(st.sampled_from(self.controllers)))

    @rule()
    def plant_is_killed(self) -> None:
        self.ends.die("plant")

    @rule(data=st.data(), plants=st.booleans())
    def a_journal_is_lost(self, data: st.DataObject, plants: bool) -> None:
        self.ends.forgot = True
        side = "plant" if plants else data.draw(st.sampled_from(self.controllers))
        self.ends.forget(side)

    @precondition(lambda self: self.ends.plant.state.session.controller is not None)
    @rule(dies=st.sampled_from(DEATHS))
    def the_controller_knows_no_session(self, dies: CrashPoint | None) -> None:
        """As one does that was misled: whatever the plant is doing, its session is over."""
        self.ends.forgot = True
        word = mail(disowned(self.ends.plant))
        self.dying("plant", dies, partial(self.ends.hear, "plant", word))

    # --- the property --------------------------------------------------------------------------

    @invariant()
    def messages_arrive_in_order_and_once(self) -> None:
        inbox = self.ends.received
        sent = sum(PAYLOADS[: len(self.controllers)], ())
        assert set(inbox) <= set(sent)
        for payloads in PAYLOADS:
            mine = [payload for payload in inbox if payload in payloads]
            assert list(out_of_order(mine, payloads, again=self.ends.forgot)) == []


class Deadlines(Link):
    """Each step takes its time, and a step without an offer is missed."""

    step_s: ClassVar[float | None] = 0.1


class Acting(Deadlines):
    """A device: a step is begun and read at its end, and its session may end in between."""

    acts = True
    rival = True


class ActingAtOnce(Acting):
    """The same in lock-step: read as soon as it was actuated."""

    step_s = None


class TwoControllers(Deadlines):
    """A second controller, with a journal of its own, on the same loop."""

    rival = True


class PipelinedLink(Deadlines):
    """Five candidates that every transition tells apart, and a symbol in every transition."""

    shared = PIPELINED

    @invariant()
    def every_key_serves_the_next_transition(self) -> None:
        counted = self.ends.counted["plant"]
        for (session, j), t in counted.items():
            assert t.symbol >= 0
            before = counted.get((session, j - 1))
            if before is not None:
                assert (t.role, t.key) == ("message", before.symbol)
            elif j == 0:
                assert t.role == "test"


SETTINGS = settings(
    max_examples=size(16, 40),
    stateful_step_count=60,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestLink, TestDeadlines, TestActing = Link.TestCase, Deadlines.TestCase, Acting.TestCase
TestTwoControllers = pytest.mark.slow(TwoControllers.TestCase)
TestPipelinedLink = pytest.mark.slow(PipelinedLink.TestCase)
TestActingAtOnce = pytest.mark.slow(ActingAtOnce.TestCase)
for kind in (Link, Deadlines, Acting, TwoControllers, PipelinedLink, ActingAtOnce):
    kind.TestCase.settings = SETTINGS


def test_the_plant_takes_an_offer_for_its_own_step_alone() -> None:
    loop = LinePair(RULES, None)
    while not (loop.plant.state.link.k >= 3 and loop.mail["plant"]):
        loop.next()
    said = loop.mail["plant"].pop(0)
    k, offer = loop.plant.state.link.k, Offer.model_validate_json(said.payload)
    for other in (k - 1, k + 1, k + 2):
        loop.hear("plant", mail(offer.model_copy(update={"k": other})))
        assert loop.plant.state.link.k == k
    loop.hear("plant", said)
    assert loop.plant.state.link.k == k + 1
