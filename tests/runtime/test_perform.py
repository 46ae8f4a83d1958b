"""The order of effects, and every death that a short run has room for."""

from collections.abc import Callable
from itertools import chain, islice

import pytest

from protocol.link.effects import Effects, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import Event, Missed
from protocol.link.session import CountedTransition
from protocol.link.step import Answered
from protocol.messages import ControllerStatus, Measurement, Message, Offer, Status
from protocol.secret.blocks import ClosedBlock
from runtime.perform import Crashed, CrashingPorts, perform
from tests.support.line_ends import line_rules
from tests.support.mail import Mail
from tests.support.records import controller_record
from tests.support.rehearsal import Rehearsal
from tests.support.two_ends import LineEnds, Name

SAID = Measurement(session="1" * 16, k=1, x=(0.0,), applied_k=0, x_after=(0.0,))
OFFER = Offer(session="1" * 16, k=0, candidates=((1.0,),), cipher=0)
STEP = Save(controller_record(), Answered(SAID, OFFER))
RECORD = Save(controller_record(k=7))
BLOCK = ClosedBlock("1" * 16, 0, 1, 1, 1, 2, "1", (b"n" * 32,), 1)
WELL = next(
    arrival.message
    for arrival in next(Rehearsal().arrivals(10))
    if isinstance(arrival.message, ControllerStatus)
)
EVENT = Missed("1" * 16, 0, (0.0,), (0.0,), (0.0,))


def a_step(done: list[object]) -> Effects:
    """What an end asks for, and when it counts."""
    yield STEP
    yield Publish(SAID)
    done.append("count")
    yield Tell(EVENT)
    yield RECORD
    yield Extract(BLOCK)
    yield Notice("told")
    yield Show(WELL)


class Listing:
    """Ports that list what is asked of them."""

    def __init__(self, done: list[object]) -> None:
        self._done = done

    def save(self, save: Save) -> None:
        self._done.append(save)

    def publish(self, message: Message) -> None:
        self._done.append(message)

    def extract(self, block: ClosedBlock) -> None:
        self._done.append(block)

    def trace(self, event: Event) -> None:
        self._done.append(event)

    def log_notice(self, notice: Notice) -> None:
        self._done.append(notice.text)

    def health(self, status: Status) -> None:
        self._done.append(status)


def test_each_effect_is_done_before_the_end_goes_on() -> None:
    done: list[object] = []
    perform(a_step(done), Listing(done))
    assert done == [STEP, SAID, "count", EVENT, RECORD, BLOCK, "told", WELL]


@pytest.mark.parametrize(("before", "done"), [
    ("saving", []),
    ("publishing", [STEP]),
    ("tracing", [STEP, SAID, "count"]),
    ("extracting", [STEP, SAID, "count", EVENT, RECORD]),
])  # fmt: skip
def test_who_dies_before_something_has_done_all_that_comes_before_it(
    before: str, done: list[object]
) -> None:
    happened: list[object] = []
    ports = CrashingPorts(Listing(happened))
    ports.crash_at(before=before)  # type: ignore[arg-type]
    with pytest.raises(Crashed):
        perform(a_step(happened), ports)
    assert happened == done


EVERYTHING = (
    Tell(EVENT),
    Tell(EVENT),
    STEP,
    Publish(SAID),
    Extract(BLOCK),
    Notice("told"),
    Show(WELL),
)
DONE = [EVENT, EVENT, STEP, SAID, BLOCK, "told", WELL]


@pytest.mark.parametrize("after", range(5))
def test_who_dies_after_so_many_things_has_done_as_many(after: int) -> None:
    """Notices and the status count for nothing."""
    happened: list[object] = []
    ports = CrashingPorts(Listing(happened))
    ports.crash_at(after=after)
    with pytest.raises(Crashed):
        perform(EVERYTHING, ports)
    assert happened == DONE[:after]


def test_who_does_not_crash_or_no_longer_lives_on() -> None:
    for crash_at in (lambda _: None, lambda ports: ports.crash_at(after=5)):
        happened: list[object] = []
        ports = CrashingPorts(Listing(happened))
        crash_at(ports)
        perform(EVERYTHING, ports)
        assert happened == DONE
    ports.crash_at()
    perform(EVERYTHING, ports)
    ports.crash_at("tracing")
    with pytest.raises(Crashed):
        perform(EVERYTHING, ports)
    ports.crash_at()
    perform(EVERYTHING, ports)
    assert happened == DONE * 3


# --- every death ----------------------------------------------------------------------------------

RULES = line_rules(alpha=4.0, largest_input=1e9)
PAYLOAD = b"a"


class Draws:
    """Random symbols, every draw another one."""

    def __init__(self) -> None:
        self._drawn = 0

    def symbol(self, transition: int, size: int) -> int:
        self._drawn += 1
        return self._drawn * 7 // 3 % size


class Pair(LineEnds):
    """Both ends on a network without faults; the ``crashing`` side dies once, at its nth act."""

    def __init__(self, crashing: str, nth: int) -> None:
        self.acts = 0
        self.died = False
        self.crashing, self.nth = crashing, nth
        self.inbox: list[bytes] = []
        self.counted: dict[Name, dict[tuple[str, int], CountedTransition]] = {
            "controller": {},
            "plant": {},
        }
        super().__init__(RULES, None, (PAYLOAD,), fresh=Draws())

    def traced(self, side: Name, event: Event) -> None:
        if isinstance(event, CountedTransition):
            self.counted[side][event.session, event.j] = event.shared
            if event.recovered is not None:
                self.inbox.append(event.recovered)

    def hear(self, side: Name, message: Mail) -> None:
        self.line.coin = len(self.counted["plant"]) % 2
        self.line.d = 0.5 if self.line.coin else -0.5
        super().hear(side, message)

    def do(self, side: Name, act: Callable[[float], Effects]) -> None:
        """One act of one side: if it is the fatal one, the side dies in it and comes back."""

        def fatal(now: float) -> Effects:
            effects = iter(act(now))
            first = tuple(islice(effects, 1))
            things = 5 if first else 0
            if side == self.crashing and not self.died:
                if self.acts <= self.nth < self.acts + things:
                    self.crash_at(side, after=self.nth - self.acts)
                    self.died = True
                self.acts += things
            return chain(first, effects)

        super().do(side, fatal)

    def until(self, transitions: int) -> None:
        self.run(lambda: len(self.counted["controller"]) >= transitions)


def test_a_run_without_a_death_delivers() -> None:
    pair = Pair("nobody", -1)
    pair.until(150)
    assert pair.inbox == [PAYLOAD]


@pytest.mark.parametrize("crashing", ["controller", "plant"])
def test_no_death_of_a_short_run_changes_what_is_counted_or_ends_the_session(crashing: str) -> None:
    """One death at each thing that an end does in its first 25 acts, some hundred runs in all."""
    deaths = 0
    for nth in range(125):
        pair = Pair(crashing, nth)
        pair.until(25)
        mine, theirs = pair.counted["plant"], pair.counted["controller"]
        assert all(mine[at] == t for at, t in theirs.items()), nth
        assert len({session for session, _ in mine}) == 1, nth
        deaths += pair.died
    assert deaths > 100
