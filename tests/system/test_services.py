"""The two services on a bus in memory: malformed, foreign models, deadlines, lost journals."""

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

import pytest

from controller_service.core import ControllerCore
from controller_service.laws.base import CandidateLaw
from controller_service.service import ControllerConfig, add_controller
from plant_service.core import PlantCore
from plant_service.service import PlantConfig, add_plant
from protocol.messages import (
    ControllerStatus,
    Message,
    Offer,
    PlantModel,
    PlantStatus,
    SendCommand,
    SendReply,
)
from protocol.scenario import Scenario
from protocol.topics import key_of
from runtime.errors import DONE, USAGE
from runtime.health import read_status
from runtime.host import Host
from runtime.logs import logger
from runtime.pace import Pace
from runtime.run_folder import (
    PLANT_STATUS,
    PLANT_TRACE,
)
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.statuses import status_of
from tests.support.traces import events_of, recovered_in

End = TypeVar("End", PlantCore, ControllerCore)


class System:
    """Both services in threads of this process, on hubs that a test can listen to and disturb."""

    def __init__(self, scenario: Scenario, law: CandidateLaw, run_dir: Path) -> None:
        self.scenario, self.law, self.run_dir = scenario, law, run_dir
        self.field, self.management = MemoryHub(), MemoryHub()
        self.codes: dict[str, int] = {}
        self.errors: dict[str, Exception] = {}
        self.plant_core: PlantCore | None = None
        self.recovered = partial(recovered_in, run_dir)
        self._stopping: dict[str, threading.Event] = {}

    @contextmanager
    def controller(
        self,
        message: bytes | None = None,
        scenario: Scenario | None = None,
        name: str = "controller",
    ) -> Iterator[ControllerCore]:
        """With another name, one with a run folder of its own."""
        config = ControllerConfig(
            scenario or self.scenario,
            self.folder(name),
            "loop",
            law=self.law,
            message=message,
            seed=1,
        )
        with self._running(
            name, lambda host: add_controller(host, config, logger("controller"))
        ) as core:
            yield core

    @contextmanager
    def plant(
        self,
        pace: str = "fast",
        steps: int | None = None,
        scenario: Scenario | None = None,
        name: str = "plant",
    ) -> Iterator[PlantCore]:
        config = PlantConfig(
            scenario or self.scenario, self.folder(name), "loop", Pace(pace), steps, seed=1
        )
        with self._running(name, lambda host: add_plant(host, config, logger("plant"))) as core:
            yield core

    def folder(self, name: str) -> Path:
        return self.run_dir if name in ("plant", "controller") else self.run_dir / name

    @contextmanager
    def _running(self, name: str, add: Callable[[Host], End]) -> Iterator[End]:
        stopping = self._stopping[name] = threading.Event()
        host = Host(MemoryBus(self.field), MemoryBus(self.management), stopping)
        core = add(host)
        if name == "plant":
            assert isinstance(core, PlantCore)
            self.plant_core = core

        def target() -> None:
            try:
                self.codes[name] = host.run()
            except Exception as error:
                self.errors[name] = error

        thread = threading.Thread(target=target)
        thread.start()
        try:
            yield core
        finally:
            stopping.set()
            thread.join(PATIENCE_S)
            assert not thread.is_alive()

    def stop(self, name: str) -> None:
        """Tell a service to end."""
        self._stopping[name].set()

    @property
    def k(self) -> int:
        assert self.plant_core is not None
        return self.plant_core.state.record.link.k

    wait = staticmethod(wait_for)


@pytest.fixture
def system(sustained: Scenario, sustained_law: CandidateLaw, tmp_path: Path) -> System:
    return System(sustained, sustained_law, tmp_path)


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
    events = events_of(system.run_dir / PLANT_TRACE, "transition")
    assert {e["k"] for e in events if e["k"] >= min(answered)} <= answered
    status = read_status(system.run_dir / PLANT_STATUS, PlantStatus)
    assert status.timing.late <= status.step.missed


def replies_on(management: MemoryBus) -> list[SendReply]:
    """The controller's replies, as they come."""
    replies: list[SendReply] = []
    management.subscribe(
        key_of(SendReply, "loop"),
        lambda _k, payload, _t: replies.append(SendReply.model_validate_json(payload)),
    )
    return replies


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
    for event in events_of(system.run_dir / PLANT_TRACE, "transition"):
        offers[state].add(tuple(json.loads(seen[event["k"]])))
        state = event["s"]
    fields = ("v", "session", "k", "candidates", "cipher", "predictions")
    assert offers[1] == offers[2] == {(*fields, "copy_number", "nonce", "heard", "block", "tag")}


# --- forged and foreign ---------------------------------------------------------------------------


def other_model(scenario: Scenario) -> Scenario:
    secrecy = scenario.secrecy.model_copy(update={"alpha": 7.0})
    return scenario.model_copy(update={"secrecy": secrecy})


@pytest.mark.parametrize("stray", ["plant", "controller"])
def test_a_stray_of_another_scenario_is_refused_alone(system: System, stray: str) -> None:
    other = other_model(system.scenario)
    with system.controller(b"one") as controller, system.plant("x20"):
        system.wait(lambda: system.k > 10)
        start = system.plant if stray == "plant" else system.controller
        with start(scenario=other, name="stray"):
            system.wait(lambda: system.codes == {"stray": USAGE})
            k = system.k
            system.wait(lambda: system.k > k + 20)
            status = status_of(controller)
            assert (status.phase, status.detail) == ("running", "")
    assert system.codes == {"stray": USAGE, "plant": DONE, "controller": DONE}
    sessions = events_of(system.run_dir / PLANT_TRACE, "session")
    assert sum(1 for _ in sessions) == 1


@pytest.mark.slow
def test_two_controllers_on_one_loop_take_turns(
    system: System, caplog: pytest.LogCaptureFixture
) -> None:
    """One of them has the session; the other one comes in when it falls silent."""
    offers: dict[tuple[str, int], set[bytes]] = {}

    def note(_key: str, payload: bytes, _t_ns: int) -> None:
        offer = Offer.model_validate_json(payload)
        offers.setdefault((offer.session, offer.k), set()).add(payload)

    MemoryBus(system.field).subscribe(key_of(Offer, "loop"), note)
    with (
        listened(caplog),
        system.controller(b"two", name="second") as second,
        system.controller(b"one") as first,
        system.plant("x20") as plant,
    ):
        names = {first.instance: b"one", second.instance: b"two"}
        system.wait(lambda: len(system.recovered()) == 1)
        mine = plant.state.session.controller
        assert mine is not None
        assert system.recovered() == [names.pop(mine)]
        running = first if mine == first.instance else second
        k = system.k
        system.wait(lambda: system.k > k + 200)
        assert plant.state.session.controller == mine
        system.stop("controller" if running is first else "second")
        (other,) = names
        system.wait(lambda: system.recovered()[1:] == [names[other]])
    assert all(len(answers) == 1 for answers in offers.values())
    told = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    for service in ("two controllers on one loop", "and not with this one"):
        assert any(service in t and mine in t and other in t for t in told), (service, told)


@contextmanager
def listened(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """The services' loggers do not propagate."""
    loggers = [logging.getLogger(name) for name in ("plant", "controller")]
    for log in loggers:
        log.addHandler(caplog.handler)
    try:
        yield
    finally:
        for log in loggers:
            log.removeHandler(caplog.handler)


# --- files ----------------------------------------------------------------------------------------


# --- commands and statuses ------------------------------------------------------------------------


def test_an_identifier_belongs_to_one_message(system: System) -> None:
    management = MemoryBus(system.management)
    answered = replies_on(management)
    put = management.publisher(key_of(SendCommand, "loop")).put
    asked = [("a", b"text"), ("a", b"text"), ("a", b"other"), ("initial", b"mine")]
    with system.controller(b"one"), system.plant():
        for name, payload in asked:
            put(SendCommand(id=name, payload=payload).wire())
        system.wait(lambda: len(answered) == len(asked))
        system.wait(lambda: len(system.recovered()) == 2)
    assert [r.accepted for r in answered] == [True, True, False, False]
    assert "already queued" in answered[1].detail
    assert "'a'" in answered[2].detail
    assert "'initial'" in answered[3].detail
    assert system.recovered() == [b"one", b"text"]


@pytest.mark.slow
def test_what_both_ends_say_is_what_a_reader_takes_and_nothing_is_missing(system: System) -> None:
    """The ends do not validate their own; every second status will do, from any moment on."""
    said: dict[type[Message], list[tuple[float, Message]]] = {}

    def listen(kind: type[Message]) -> None:
        def hear(_key: str, payload: bytes, _t_ns: int) -> None:
            message = kind.model_validate_json(payload)
            assert message.wire() == payload
            said.setdefault(kind, []).append((time.monotonic(), message))

        MemoryBus(system.management).subscribe(key_of(kind, "loop"), hear)

    for kind in (PlantModel, PlantStatus, ControllerStatus):
        listen(kind)
    with system.controller(b"one"), system.plant("x20", steps=700):
        system.wait(lambda: "plant" in system.codes)
    models = [message for _, message in said[PlantModel]]
    assert len(set(map(Message.wire, models))) == 1
    times = [t for t, _ in said[PlantModel]]
    assert times[0] < said[PlantStatus][0][0]
    assert 1 < len(times) <= 1 + len(said[PlantStatus]) / 20
    assert len(said[ControllerStatus]) > 10
    statuses = [s for _, s in said[PlantStatus] if isinstance(s, PlantStatus)]
    counted = [e["k"] for e in events_of(system.run_dir / PLANT_TRACE, "transition")]
    tails = [{row.k for row in s.secrets.tail} for s in statuses]
    counts = [s.step.transitions for s in statuses]
    sizes = [len(tail) for tail, s in zip(tails, statuses, strict=True) if s.step.k > 100]
    assert max(sizes) == 64
    assert sorted(sizes)[len(sizes) // 2] < 40
    for heard in (slice(None), slice(None, None, 2), slice(1, None, 2)):
        assert set().union(*tails[heard]) >= set(counted[: counts[heard][-1]])
    late = slice(len(statuses) // 2, len(statuses) // 2 + 20)
    whole = zip(tails[late], counts[late], strict=True)
    assert any(tail >= set(counted[n - 64 : n]) for tail, n in whole)


# --- frames and restarts --------------------------------------------------------------------------
