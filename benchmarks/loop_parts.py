"""What a control step costs beside the transport: each part timed in one process.

The same objects as in the services, driven directly: the plant and the controller's core with
the scenario's law, real journals and traces in a temporary folder, messages through JSON.
"""

import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from protocol.link.events import lines
from runtime.host import FIELD

if TYPE_CHECKING:
    from protocol.link.events import Event
    from protocol.link.peer import Actions, Notice, Peer
    from protocol.messages import Message, Status
    from protocol.scenario import Scenario
    from protocol.secret.tasks import Task
    from runtime.ports import Files

T = TypeVar("T")

STATUS_RATE_HZ: Final = 20.0
"""Statuses a second of each service; a step carries its share of one."""

WHILE_WAITING: Final = "while waiting: "
"""What a service does once its message is on the way, while its partner works."""

MESSAGE: Final = b"A message long enough to last, so that each second frame is under way. " * 10


class Stopwatch:
    """Collects how long each part of a step took."""

    def __init__(self) -> None:
        self._ns: dict[str, list[int]] = {}

    def time(self, part: str, work: Callable[[], T]) -> T:
        """Do ``work`` and note its time under ``part``."""
        before = time.perf_counter_ns()
        result = work()
        self._ns.setdefault(part, []).append(time.perf_counter_ns() - before)
        return result

    def take_off(self, part: str, inner: str) -> None:
        """Take the last time of ``inner``, which ran within ``part``, off the last of ``part``."""
        self._ns[part][-1] -= self._ns[inner][-1]

    def medians_us(self) -> dict[str, float]:
        """Median of each part, microseconds."""
        return {part: statistics.median(values) / 1e3 for part, values in self._ns.items()}


def measure_parts(
    scenario_file: Path, steps: int, steps_per_second: float, pause_s: float
) -> dict[str, float]:
    """Microseconds a step of each part, medians over ``steps`` steps in one process.

    Parts whose name begins with `WHILE_WAITING` do not hold up the step.

    Parameters
    ----------
    scenario_file : Path
    steps : int
    steps_per_second : float
        The live loop's, over which a status is spread.
    pause_s : float
        Sleep before each half of a step, as long as the transport's one-way trip. Without it the
        caches stay warm and every part looks up to half as long as it is in the live loop.

    Raises
    ------
    protocol.scenario.ScenarioError
        When the scenario cannot be used.
    """
    from runtime.scenario_file import load_scenario

    scenario = load_scenario(scenario_file)
    with tempfile.TemporaryDirectory(prefix="wyner-bench-") as name:
        parts = _steps(scenario, Path(name), steps, pause_s)
        statuses = _statuses(scenario, Path(name) / "statuses")
    for service, us in statuses.items():
        parts[f"{WHILE_WAITING}{service}: telemetry"] = us * STATUS_RATE_HZ / steps_per_second
    return parts


class TimedPorts:
    """A service's ports; the write that holds up a step is timed under ``side``'s name."""

    def __init__(
        self, side: str, partner: "list[Message]", watch: Stopwatch, files: "Files"
    ) -> None:
        self.files = files
        self._side = side
        self._partner = partner
        self._watch = watch

    def save(self, actions: "Actions") -> None:
        """Keep it in the journal."""
        if actions.offer is not None:
            self._watch.time(f"{self._side}: journal", lambda: self.files.journal.save(actions))
        else:
            self.files.journal.save(actions)

    def publish(self, message: "Message") -> None:
        """Leave it for the partner."""
        self._partner.append(message)

    def submit_key_task(self, task: "Task") -> None:
        """Hand it to the keeper's thread."""
        raise AssertionError(f"this scenario makes no keys: {task}")

    def trace(self, event: "Event") -> None:
        """Write it to the trace."""
        self.files.trace.write(*lines(event))

    def log_notice(self, notice: "Notice") -> None:
        """Nobody reads the log."""

    def health(self, status: "Status") -> None:
        """Nobody asks for the health."""


def _steps(scenario: "Scenario", folder: Path, steps: int, pause_s: float) -> dict[str, float]:
    """Plant and controller in lock-step, everything but transport and telemetry."""
    from controller_service.core import ControllerCore
    from controller_service.laws.registry import cached_design, make_law
    from plant_service.opening import open_core
    from protocol.link.pacing import Pacing
    from protocol.link.session import rules_of
    from protocol.streams import CIPHER, COIN
    from runtime.chance import noise, symbols
    from runtime.ids import new_id
    from runtime.journal import ControllerJournal, PlantJournal
    from runtime.perform import perform
    from runtime.ports import Files
    from runtime.recording import TraceWriter
    from runtime.run_folder import (
        CONTROLLER_JOURNAL,
        CONTROLLER_TRACE,
        PLANT_JOURNAL,
        PLANT_TRACE,
    )

    watch = Stopwatch()
    law = make_law(scenario, cached_design(scenario))
    fingerprint = scenario.fingerprint()
    queue = ControllerJournal(folder / CONTROLLER_JOURNAL, fingerprint)
    controller = ControllerCore(
        rules_of(scenario),
        lambda x: watch.time("controller: law", lambda: law.candidates(x)),
        queue,
        symbols(None, CIPHER),
        instance=new_id(),
        period_s=scenario.plant.period_s,
        message=MESSAGE,
    )
    journal = PlantJournal(folder / PLANT_JOURNAL, fingerprint)
    coin, disturbances = symbols(None, COIN), noise(None, scenario.n)
    now = time.monotonic()
    pacing = Pacing(None, scenario.link.repeats_per_period, now)
    plant = open_core(scenario, journal, coin, disturbances, new_id, now, pacing)
    traces = [
        TraceWriter(folder / CONTROLLER_TRACE, "controller", {}),
        TraceWriter(folder / PLANT_TRACE, "plant", {}),
    ]
    mail: dict[str, list[Message]] = {"controller": [], "plant": []}
    ends: list[tuple[str, Peer, TimedPorts]] = [
        (name, endpoint, TimedPorts(name, mail[partner], watch, files))
        for name, partner, endpoint, files in (
            ("controller", "plant", controller, Files(queue, traces[0], folder)),
            ("plant", "controller", plant, Files(journal, traces[1], folder)),
        )
    ]
    for _name, endpoint, ports in ends:
        perform(endpoint.start(time.monotonic()), endpoint, ports)
    while plant.record.k < steps:
        for name, endpoint, ports in ends:
            now = time.monotonic()
            if endpoint.wake_at() <= now:
                perform(endpoint.wake(now), endpoint, ports)
            heard = mail[name][:]
            mail[name].clear()
            time.sleep(pause_s)
            for message in heard:
                kind, payload = type(message), message.wire()
                step = f"{name}: parse, decide, dump"
                receive = partial(endpoint.receive, kind, payload, time.monotonic())
                actions = watch.time(step, receive) if kind in FIELD else receive()
                if name == "controller" and kind in FIELD:
                    watch.take_off(step, "controller: law")
                perform(actions._replace(finish_step=False), endpoint, ports)
                if actions.finish_step:
                    rest = partial(lambda e, p: perform(e.finish_step(), e, p), endpoint, ports)
                    watch.time(f"{WHILE_WAITING}{name}: count and trace", rest)
    for _name, _endpoint, ports in ends:
        ports.files.close()
    return watch.medians_us()


def _statuses(scenario: "Scenario", folder: Path, steps: int = 200) -> dict[str, float]:
    """Microseconds of one status of the plant and of the controller, in the middle of a run.

    Both services run over a bus in memory, the plant in a thread of its own.
    """
    import logging

    from controller_service.laws.registry import cached_design, make_law
    from controller_service.service import ControllerConfig, ControllerService
    from plant_service.service import PlantConfig, PlantService
    from runtime.logs import logger
    from runtime.memory_bus import MemoryBus, MemoryHub
    from runtime.pace import Pace

    logs = [logger(name) for name in ("plant", "controller")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.WARNING)
    field, management = MemoryHub(), MemoryHub()
    stopping = threading.Event()
    law = make_law(scenario, cached_design(scenario))
    times: dict[str, float] = {}

    def time_status(service: str, status: "Callable[[], Message]") -> None:
        watch = Stopwatch()
        for _ in range(200):
            watch.time(service, lambda: status().wire())
        times.update(watch.medians_us())

    def run_plant() -> None:
        try:
            config = PlantConfig(scenario, folder, "loop", Pace("fast"), steps=steps)
            plant = PlantService(config, MemoryBus(field), MemoryBus(management), threading.Event())
            plant.run()
            time_status("plant", lambda: plant.endpoint.status(time.monotonic()))
        finally:
            stopping.set()

    controller_config = ControllerConfig(scenario, folder, "loop", law, message=MESSAGE)
    controller = ControllerService(
        controller_config, MemoryBus(field), MemoryBus(management), stopping
    )
    time_status("controller", controller.endpoint.status)
    thread = threading.Thread(target=run_plant)
    thread.start()
    controller.run()
    thread.join()
    for log, level in zip(logs, levels, strict=True):
        log.setLevel(level)
    return times
