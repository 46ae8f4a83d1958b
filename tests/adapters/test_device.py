"""Plants that act: the order of a step, failures, watchdog and safe state."""

import json
import threading
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law, synthesise
from plant_service import opening
from plant_service.adapters import PlantError
from plant_service.adapters.registry import open_plant
from plant_service.core import PlantCore
from plant_service.opening import open_core
from plant_service.service import PlantConfig, add_plant
from plant_service.status import PlantTelemetry
from protocol.link.effects import Effects, Publish, Save, Tell
from protocol.link.events import Interrupted, Missed
from protocol.link.pacing import Pacing
from protocol.link.step import IDLE, Begun, Read
from protocol.messages import ControllerHello, Measurement, Offer
from protocol.scenario import Scenario
from protocol.streams import COIN, SeededSymbols, Stream
from protocol.topics import key_of
from runtime.bus import TransportError
from runtime.errors import UsageError
from runtime.host import Host
from runtime.journal import PlantJournal
from runtime.logs import logger
from runtime.pace import Pace
from runtime.run_folder import PLANT_JOURNAL, PLANT_SAFE, PLANT_TRACE
from tests.adapters.plants import Device
from tests.support.journals import plant_journal
from tests.support.mail import mail
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.told import log_of
from wyner.api import load, vary

OBJECT = "tests.adapters.plants:PythonLine"


def line(name: str = OBJECT, **link: Any) -> Scenario:
    """The double integrator under the packed law, as a plant that nobody can put back."""
    s = load("packed-double-integrator")
    data = json.loads(s.model_dump_json(exclude_none=True, exclude_unset=True))
    plant = data["plant"]
    data["defender"] |= {"A": plant["A"], "B": plant["B"]}
    data["plant"] = {
        "kind": "python",
        "object": name,
        "period_s": 1.0,
        "disturbance": {"enters": "none"},
        "operating_point": {
            "state": [0.0, 0.0],
            "input": [0.0],
            "state_scale": [2.0, 2.0],
            "input_scale": [2.0],
        },
    }
    data["link"] = {"fallback": "hold", **link}
    from wyner.api import build

    return build(data)


@pytest.fixture(scope="module")
def law() -> CandidateLaw:
    scenario = line()
    return make_law(scenario, synthesise(scenario))


# --- one step -------------------------------------------------------------------------------------


class Bench:
    """A plant's endpoint with a device, driven by hand."""

    def __init__(
        self,
        device: Any,
        journal: PlantJournal | None = None,
        *,
        met: bool = True,
        **link: Any,
    ) -> None:
        self.device = device
        self.journal = journal or plant_journal()
        self.names = 0
        scenario = line(**link)
        self.news = PlantTelemetry.of(scenario, "realtime", seeded=True)
        self.endpoint = open_core(
            scenario,
            self.journal,
            SeededSymbols(1, COIN),
            Stream(1, 0, width=0),
            self.name,
            0.0,
            Pacing(1.0, scenario.link.repeats_per_period, 0.0),
            news=self.news,
            own=device,
        )
        self.events: list[Any] = []
        self.published: list[Any] = []
        self.do(self.endpoint.start(0.0))
        if met:
            self.greet(0.0)
            self.accept(0.0)

    @property
    def record(self) -> Any:
        return self.endpoint.state.record

    def name(self) -> str:
        self.names += 1
        return f"{self.names:016x}"

    def greet(self, now: float) -> None:
        self.hear(now, verdict="greeting")

    def accept(self, now: float) -> None:
        session = self.endpoint.state.record.session.id
        self.hear(now, verdict="accepted", session=session, answers=self.endpoint.instance)

    def hear(self, now: float, **said: Any) -> None:
        fingerprint = self.endpoint.state.rules.fingerprint
        hello = ControllerHello(instance="2" * 16, incarnation=1, fingerprint=fingerprint, **said)
        self.do(self.endpoint.receive(ControllerHello, hello.wire(), now))

    def offer(self, now: float, u: float = 0.5) -> Effects:
        rows = tuple((u * sign,) for sign in (1.0, -1.0, 0.5, -0.5))
        size = self.endpoint.state.rules.size
        candidates = rows[:size]
        offer = Offer(
            session=self.record.session.id, k=self.record.link.k, candidates=candidates, cipher=0
        )
        return self.endpoint.receive(Offer, offer.wire(), now)

    def do(self, effects: Effects) -> None:
        """What `perform` does, step by step."""
        for effect in effects:
            match effect:
                case Tell(event):
                    self.events.append(event)
                case Save():
                    self.journal.save(effect)
                    self.device.calls.append("save")
                case Publish(Measurement() as message):
                    self.published.append(mail(message))


def test_coin_journal_apply_sample_journal_report() -> None:
    bench = Bench(Device())
    assert bench.endpoint.stepper.plant.acts
    bench.device.calls.clear()
    effects = iter(bench.offer(0.2))
    begun = next(effects)
    assert isinstance(begun, Save)
    assert isinstance(begun.step, Begun)
    offer, coin = begun.step
    assert bench.device.calls == []  # nothing moves before it is saved
    bench.do(chain((begun,), effects))
    assert bench.device.calls == ["save", "apply"]
    assert bench.journal.load().step == begun.step
    bench.do(bench.endpoint.wake(0.9))
    assert "sample" not in bench.device.calls
    bench.published.clear()
    bench.do(bench.endpoint.wake(1.05))
    assert bench.device.calls == ["save", "apply", "sample", "save"]
    (report,) = bench.published
    measurement = Measurement.model_validate_json(report.payload)
    assert (measurement.k, measurement.applied_k) == (1, 0)
    assert bench.journal.load().step == Read(offer, coin, measurement)
    assert measurement.x == tuple(v / 2 for v in bench.device.y)
    assert bench.record.link.transitions == 1
    assert bench.news.punctuality.sampled_late_s[2] == pytest.approx(0.05)
    assert bench.news.punctuality.actuated_after_s[2] == pytest.approx(0.2)


def test_a_device_keeps_its_input_through_a_missed_step_and_then_gets_the_fallback() -> None:
    bench = Bench(Device(), fallback="zero")
    bench.do(bench.offer(0.2))
    bench.do(bench.endpoint.wake(1.0))
    in_force = bench.record.applied.u
    bench.device.calls.clear()
    bench.do(bench.endpoint.wake(2.0))
    assert bench.device.calls == ["sample", "apply", "save"]
    (missed,) = [e for e in bench.events if isinstance(e, Missed)]
    assert missed.u == in_force != (0.0,)
    assert bench.record.applied.u == (0.0,) == (bench.device.u,)
    bench.device.calls.clear()
    bench.do(bench.endpoint.wake(3.0))
    assert bench.device.calls == ["sample", "save"]
    assert [e.u for e in bench.events if isinstance(e, Missed)][1] == (0.0,)


# --- what dies in between -------------------------------------------------------------------------


@pytest.mark.parametrize("fallback", ["hold", "zero"])
def test_a_death_after_a_word_of_the_controllers_still_knows_the_step_under_way(
    fallback: str,
) -> None:
    """What is saved while a device acts names the step: after a death its input is not made up."""
    bench = Bench(Device(), fallback=fallback)
    bench.do(bench.offer(0.2))
    begun = bench.journal.load().step
    assert isinstance(begun, Begun)
    bench.greet(0.5)
    assert bench.journal.load().step == begun
    back = Bench(Device(), bench.journal, fallback=fallback)  # and then the process dies
    (event,) = [e for e in back.events if isinstance(e, Interrupted)]
    assert (event.session, event.coin) == (bench.record.session.id, begun.coin)
    assert event.u == begun.offer.candidates[begun.coin] != (0.0,)
    assert (back.record.link.transitions, back.record.applied.missed) == (0, 1)
    assert back.journal.load().step is IDLE
    # whether the input was applied is not known: the plant is told what the step to come is given
    assert back.device.calls[:2] == ["start", "apply"]
    given = event.u if fallback == "hold" else (0.0,)
    assert back.record.applied.u == given == (back.device.u / 2,)


# --- failures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["apply", "sample"])
def test_a_device_that_fails_is_safe_before_anything_else_happens(where: str) -> None:
    device = Device()
    bench = Bench(device)
    if where == "apply":
        device.raises = OSError("no answer")
        with pytest.raises(PlantError, match="plant: apply: OSError: no answer"):
            bench.do(bench.offer(0.2))
    else:
        bench.do(bench.offer(0.2))
        device.reading = lambda y: (float("nan"), 0.0)
        with pytest.raises(PlantError, match="expected finite numbers"):
            bench.do(bench.endpoint.wake(1.0))
    assert device.calls[-1] == "safe"
    bench.do(bench.endpoint.stop(1.0))
    assert device.calls[-2:] == ["safe", "close"]


@pytest.mark.parametrize("begun", [False, True], ids=["read", "begun"])
def test_the_watchdog_watches_a_plant_that_was_started_again_from_the_first_second(
    begun: bool,
) -> None:
    """Its controller is gone: nobody but the watchdog sees that it holds its input."""
    first = Bench(Device(), watchdog_s=2.5)
    first.do(first.offer(0.2))
    if not begun:
        first.do(first.endpoint.wake(1.0))
    device = Device()
    back = Bench(device, first.journal, met=False, watchdog_s=2.5)
    assert back.endpoint.wake_at() <= 2.5
    for now in (1.0, 2.0):
        back.do(back.endpoint.wake(now))
    with pytest.raises(PlantError, match=r"the watchdog: no offer was applied for 2.5 s"):
        back.do(back.endpoint.wake(2.51))
    assert device.calls[-1] == "safe"


def test_a_plant_that_has_never_moved_has_time_to_meet_its_controller() -> None:
    bench = Bench(Device(), met=False, watchdog_s=2.5)
    bench.do(bench.endpoint.wake(9.9))
    with pytest.raises(PlantError, match=r"the watchdog: no offer was applied for 10 s"):
        bench.do(bench.endpoint.wake(10.1))
    met = Bench(Device(), watchdog_s=2.5)  # and its controller offers nothing
    for now in (1.0, 2.0, 3.0):
        met.do(met.endpoint.wake(now))
    with pytest.raises(PlantError, match=r"the watchdog: no offer was applied for 2.5 s"):
        met.do(met.endpoint.wake(3.51))


@pytest.mark.slow
def test_the_safe_state_outlives_the_process_until_it_is_cleared(tmp_path: Path) -> None:
    scenario = vary(line(), {"plant.object": "tests.adapters.plants:Failing"})
    config = PlantConfig(scenario, tmp_path, "loop", Pace("realtime"), seed=1)
    management = MemoryHub()
    buses = MemoryBus(MemoryHub()), MemoryBus(management)
    host = Host(*buses, threading.Event())
    core = add_plant(host, config, logger("plant"))
    assert core.stepper.plant.acts
    taken_up(core, management)
    with pytest.raises(PlantError, match="RuntimeError: the belt is torn"):
        host.run()
    assert "the belt is torn" in (tmp_path / PLANT_SAFE).read_text()
    with pytest.raises(UsageError, match=r"safe state: .*belt is torn .*--clear-safe"):
        add_plant(Host(*buses, threading.Event()), config, logger("plant"))


def taken_up(core: PlantCore, management: MemoryHub) -> None:
    """A controller takes the session up, as soon as the service runs; it offers nothing."""
    hello = ControllerHello(
        instance="2" * 16,
        incarnation=1,
        fingerprint=core.state.rules.fingerprint,
        verdict="greeting",
    )
    put = MemoryBus(management).publisher(key_of(ControllerHello, "loop")).put
    put(hello.wire())
    answer = {
        "verdict": "accepted",
        "session": core.state.record.session.id,
        "answers": core.instance,
    }
    put(hello.model_copy(update=answer).wire())


def device_service(
    device: Any,
    run_dir: Path,
    monkeypatch: pytest.MonkeyPatch,
    stopping: threading.Event,
    management: MemoryHub | None = None,
) -> tuple[Host, PlantCore]:
    """The host of a plant that is a device in this process, and its core."""
    opened = partial(open_plant, own=device)
    monkeypatch.setattr(opening, "open_plant", lambda scenario, *_: opened(scenario))
    config = PlantConfig(line(), run_dir, "loop", Pace("realtime"), seed=1)
    buses = MemoryBus(MemoryHub()), MemoryBus(management or MemoryHub())
    host = Host(*buses, stopping)
    return host, add_plant(host, config, logger("plant"))


def test_a_device_that_cannot_be_let_go_of_hides_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stuck(Device):
        def close(self) -> None:
            super().close()
            raise OSError("the port is gone")

    device, management = Stuck(), MemoryHub()
    host, core = device_service(device, tmp_path, monkeypatch, threading.Event(), management)
    taken_up(core, management)
    device.reading = lambda y: (float("nan"), 0.0)
    with log_of("plant") as lines, pytest.raises(PlantError, match="expected finite numbers"):
        host.run()
    assert device.calls[-2:] == ["safe", "close"]
    assert "expected finite numbers" in (tmp_path / PLANT_SAFE).read_text()
    assert "plant: close: OSError: the port is gone" in lines
    # and what was open is closed: its journal can be opened again
    PlantJournal(tmp_path / PLANT_JOURNAL, line().fingerprint()).close()


@pytest.mark.parametrize("where", ["trace", "bus"])
def test_a_service_that_cannot_start_leaves_its_device_safe(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = Device()
    if where == "trace":
        (tmp_path / PLANT_TRACE).mkdir(parents=True)
    else:

        def fails(*_: object, **__: object) -> None:
            raise TransportError("no bus")

        monkeypatch.setattr(MemoryBus, "publisher", fails)
    with pytest.raises((OSError, TransportError)):
        device_service(device, tmp_path, monkeypatch, threading.Event())
    assert device.calls == ["start", "safe", "close"]
