"""The order of effects, and deaths between them."""

import pytest

from protocol.link.effects import Effects, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import Event, Missed
from protocol.link.step import Answered
from protocol.messages import ControllerStatus, Measurement, Message, Offer, Status
from protocol.secret.blocks import ClosedBlock
from runtime.perform import Crashed, CrashingPorts, perform
from tests.support.records import controller_record
from tests.support.rehearsal import Rehearsal

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
