"""The two services on a bus in memory: garbage, foreign models, deadlines, lost journals."""

import base64
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from controller_service.laws import ControlLaw
from controller_service.service import CONTROLLER_HEALTH, ControllerConfig, ControllerService
from plant_service.service import PLANT_HEALTH, PlantConfig, PlantService
from protocol.journal import CONTROLLER_JOURNAL, PLANT_JOURNAL, ControllerJournal, PlantJournal
from protocol.keys import key_of
from protocol.memory_bus import MemoryBus, MemoryHub
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Offer,
    PlantHello,
    PlantStatus,
    SendCommand,
    SendReply,
)
from protocol.runtime import DONE, USAGE, Pace, UsageError
from protocol.scenario import Scenario
from protocol.trace import CONTROLLER_TRACE, PLANT_TRACE, read_trace


class System:
    """Both services in threads of this process, on hubs that a test can listen to and disturb."""

    def __init__(self, scenario: Scenario, law: ControlLaw, run_dir: Path) -> None:
        self.scenario, self.law, self.run_dir = scenario, law, run_dir
        self.field, self.ops = MemoryHub(), MemoryHub()
        self.codes: dict[str, int] = {}
        self.plant_service: PlantService | None = None

    @contextmanager
    def controller(
        self, message: bytes | None = None, scenario: Scenario | None = None
    ) -> Iterator[None]:
        config = ControllerConfig(
            scenario or self.scenario, self.law, self.run_dir, "loop", message, seed=1
        )
        with self._running("controller", lambda stopping: ControllerService(
            config, MemoryBus(self.field), MemoryBus(self.ops), stopping
        )):  # fmt: skip
            yield

    @contextmanager
    def plant(self, pace: str = "fast", steps: int | None = None) -> Iterator[None]:
        config = PlantConfig(self.scenario, self.run_dir, "loop", Pace(pace), steps, seed=1)
        with self._running("plant", lambda stopping: PlantService(
            config, MemoryBus(self.field), MemoryBus(self.ops), stopping
        )):  # fmt: skip
            yield

    @contextmanager
    def _running(
        self, name: str, make: Callable[[threading.Event], PlantService | ControllerService]
    ) -> Iterator[None]:
        stopping = threading.Event()
        service = make(stopping)
        if isinstance(service, PlantService):
            self.plant_service = service

        def target() -> None:
            self.codes[name] = service.run()

        thread = threading.Thread(target=target)
        thread.start()
        try:
            yield
        finally:
            stopping.set()
            thread.join(10)
            assert not thread.is_alive()

    @property
    def k(self) -> int:
        assert self.plant_service is not None
        return self.plant_service.plant.receiver.record.k

    def wait(self, condition: Callable[[], bool], seconds: float = 20.0) -> None:
        until = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < until, "waited in vain"
            time.sleep(0.01)

    def recovered(self) -> list[bytes]:
        try:
            events = read_trace(self.run_dir / PLANT_TRACE).of("recovered")
        except OSError:
            return []
        return [base64.b64decode(e["payload"]) for e in events]


@pytest.fixture
def system(sustained: Scenario, sustained_law: ControlLaw, tmp_path: Path) -> System:
    return System(sustained, sustained_law, tmp_path)


def test_a_message_arrives_and_both_traces_agree(system: System) -> None:
    with system.controller(b"one"), system.plant(steps=800):
        system.wait(lambda: "plant" in system.codes)
    assert system.codes == {"plant": DONE, "controller": DONE}
    assert system.recovered() == [b"one"]
    plant = {e["j"]: e for e in read_trace(system.run_dir / PLANT_TRACE).of("transition")}
    controller = read_trace(system.run_dir / CONTROLLER_TRACE).of("transition")
    for event in controller:
        mine = plant.pop(event["j"])
        assert {k: mine[k] for k in event} == event
    assert not plant


@pytest.mark.parametrize("pace", ["fast", "x20"])
def test_garbage_on_every_key_is_counted_and_ignored(system: System, pace: str) -> None:
    """With a deadline too, where most of it comes while the plant waits for the tick."""
    field, ops = MemoryBus(system.field), MemoryBus(system.ops)
    junk = [b"", b"{", b"\xff\xfe", b"[]", b'{"v":2}', b'{"v":1,"session":"x"}', b"null" * 50]
    offer = Offer(session="0" * 16, k=0, candidates=((1.0,),), cipher=7)
    measurement = Measurement(session="0" * 16, k=0, x=(1.0,), applied_k=-1, x_after=())
    rounds = 20
    with system.controller(b"one"), system.plant(pace):
        for i in range(rounds):
            for payload in junk:
                for kind in (Measurement, Offer):
                    field.publisher(key_of(kind, "loop")).put(payload)
                for command in (PlantHello, ControllerHello, SendCommand):
                    ops.publisher(key_of(command, "loop")).put(payload)
            for message in (offer, measurement):
                key = key_of(type(message), "loop")
                field.publisher(key).put(message.wire())
            system.wait(lambda i=i: system.k > 3 * i)  # type: ignore[misc]
        system.wait(lambda: system.recovered() == [b"one"])
    plant = PlantStatus.model_validate_json((system.run_dir / PLANT_HEALTH).read_bytes())
    controller = ControllerStatus.model_validate_json(
        (system.run_dir / CONTROLLER_HEALTH).read_bytes()
    )
    assert plant.garbage == rounds * (2 * len(junk) + 1)
    assert controller.garbage == rounds * (3 * len(junk) + 1)


def test_an_offer_for_the_next_step_is_not_applied_before_the_tick(system: System) -> None:
    """Whoever answers a measurement before it is sent cannot make the plant step twice a tick."""
    forger = MemoryBus(system.field)
    put = forger.publisher(key_of(Offer, "loop")).put
    answered = set()

    def hurry(_key: str, payload: bytes, _t_ns: int) -> None:
        offer = Offer.model_validate_json(payload)
        answered.add(offer.k)
        put(offer.model_copy(update={"k": offer.k + 1}).wire())

    with system.controller(b"one"), system.plant("x20", steps=60):
        forger.subscribe(key_of(Offer, "loop"), hurry)  # last, so that the true offer goes first
        system.wait(lambda: "plant" in system.codes)
    events = read_trace(system.run_dir / PLANT_TRACE).of("transition")
    assert {e["k"] for e in events if e["k"] >= min(answered)} <= answered
    status = PlantStatus.model_validate_json((system.run_dir / PLANT_HEALTH).read_bytes())
    assert status.late <= status.missed


def test_messages_queue_up_in_order_and_the_same_id_only_once(system: System) -> None:
    ops = MemoryBus(system.ops)
    replies: list[SendReply] = []
    ops.subscribe(
        key_of(SendReply, "loop"),
        lambda _k, payload, _t: replies.append(SendReply.model_validate_json(payload)),
    )
    put = ops.publisher(key_of(SendCommand, "loop")).put
    with system.controller(), system.plant():
        for name, payload in (("a", b"first"), ("a", b"again"), ("b", b"second"), ("c", b"3")):
            put(SendCommand(id=name, payload=payload).wire())
        put(SendCommand(id="huge", payload=b"x" * 70000).wire())
        system.wait(lambda: len(system.recovered()) == 3)
    assert system.recovered() == [b"first", b"second", b"3"]
    assert [r.accepted for r in replies] == [True] * 4 + [False]
    assert "70000" in replies[-1].detail


def test_a_message_is_queued_when_no_step_is_left_to_count_again(system: System) -> None:
    """A step decided before it came, counted again after it, would be taken for its start."""
    ops = MemoryBus(system.ops)
    replies: list[bytes] = []
    ops.subscribe(key_of(SendReply, "loop"), lambda _k, payload, _t: replies.append(payload))
    path = system.run_dir / CONTROLLER_JOURNAL
    with system.controller(), system.plant(steps=60):
        system.wait(lambda: "plant" in system.codes)
    with ControllerJournal(path, system.scenario.fingerprint()) as journal:
        before = journal.load()
        assert before is not None
        assert journal.step() is not None
    with system.controller():
        ops.publisher(key_of(SendCommand, "loop")).put(SendCommand(id="a", payload=b"late").wire())
        system.wait(lambda: bool(replies))
    with ControllerJournal(path, system.scenario.fingerprint()) as journal:
        after = journal.load()
        assert after is not None
        assert after.k == before.k + 1
        assert journal.step() is None
        assert journal.queued == 1


def test_another_model_is_refused_by_both(system: System) -> None:
    secrecy = system.scenario.secrecy.model_copy(update={"alpha": 7.0})
    other = system.scenario.model_copy(update={"secrecy": secrecy})
    with system.controller(scenario=other), system.plant():
        system.wait(lambda: system.codes.keys() == {"plant", "controller"})
    assert system.codes == {"plant": USAGE, "controller": USAGE}
    assert list(read_trace(system.run_dir / PLANT_TRACE).of("transition")) == []


def test_late_offers_are_missed_steps(system: System) -> None:
    with system.plant("x20"):
        with system.controller(b"one"):
            system.wait(lambda: system.k > 20)
        missed_from = system.k
        system.wait(lambda: system.k > missed_from + 20)
        with system.controller(b"one"):
            system.wait(lambda: system.k > missed_from + 60)
    trace = read_trace(system.run_dir / PLANT_TRACE)
    assert sum(1 for _ in trace.of("missed")) >= 19
    counted = {(e["session"], e["j"]) for e in trace.of("transition")}
    theirs = {
        (e["session"], e["j"])
        for e in read_trace(system.run_dir / CONTROLLER_TRACE).of("transition")
    }
    assert theirs <= counted
    assert len(counted - theirs) <= 1
    assert len({session for session, _ in counted}) == 1


@pytest.mark.parametrize("lost", ["controller", "plant"])
def test_a_lost_journal_ends_the_session_and_the_message_still_arrives(
    system: System, lost: str
) -> None:
    with system.controller(b"a longer message"), system.plant(steps=200):
        system.wait(lambda: "plant" in system.codes)
    journal = system.run_dir / (CONTROLLER_JOURNAL if lost == "controller" else PLANT_JOURNAL)
    for path in journal.parent.glob("journal.sqlite3*"):
        path.unlink()
    with system.controller(b"a longer message"), system.plant():
        system.wait(lambda: b"a longer message" in system.recovered())
    sessions = {e["session"] for e in read_trace(system.run_dir / PLANT_TRACE).of("transition")}
    assert len(sessions) == 2


def test_a_journal_serves_one_process_at_a_time(system: System) -> None:
    with system.plant(), pytest.raises(UsageError, match="another process"), system.plant():
        pass


def test_the_inbox_outlives_the_process(system: System) -> None:
    with system.controller(b"kept"), system.plant(steps=900):
        system.wait(lambda: "plant" in system.codes)
    with PlantJournal(system.run_dir / PLANT_JOURNAL, system.scenario.fingerprint()) as journal:
        assert journal.inbox() == [b"kept"]


def test_field_messages_look_the_same_in_both_states(system: System) -> None:
    offers: dict[int, set[tuple[str, ...]]] = {1: set(), 2: set()}
    seen: dict[int, bytes] = {}
    listener = MemoryBus(system.field)
    listener.subscribe(
        key_of(Offer, "loop"),
        lambda _k, payload, _t: seen.update({json.loads(payload)["k"]: payload}),
    )
    with system.controller(b"one"), system.plant(steps=400):
        system.wait(lambda: "plant" in system.codes)
    state = 1
    for event in read_trace(system.run_dir / PLANT_TRACE).of("transition"):
        offers[state].add(tuple(json.loads(seen[event["k"]])))
        state = event["s"]
    assert offers[1] == offers[2] == {("v", "session", "k", "candidates", "cipher")}
