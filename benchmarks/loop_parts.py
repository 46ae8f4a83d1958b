"""What a control step costs beside the transport: each part timed in one process.

The same objects as in the services, driven directly: the plant and the controller's sender with
the scenario's law, real journals and traces in a temporary folder, messages through JSON.
"""

import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

if TYPE_CHECKING:
    from protocol.messages import Message
    from protocol.scenario import Scenario

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
    from protocol.scenario import load_scenario

    scenario = load_scenario(scenario_file)
    with tempfile.TemporaryDirectory(prefix="wyner-bench-") as name:
        parts = _steps(scenario, Path(name), steps, pause_s)
        statuses = _statuses(scenario, Path(name) / "statuses")
    for service, us in statuses.items():
        parts[f"{WHILE_WAITING}{service}: telemetry"] = us * STATUS_RATE_HZ / steps_per_second
    return parts


def _steps(scenario: "Scenario", folder: Path, steps: int, pause_s: float) -> dict[str, float]:
    """Plant and controller in lock-step, everything but transport and telemetry."""
    from controller_service.laws.paper import make_law
    from controller_service.sets.design import cached_design
    from plant_service.plant import Move, Plant, first_record
    from protocol.link.sender import Sender
    from protocol.link.session import rules_of
    from protocol.messages import ControllerHello, Measurement, Offer
    from protocol.runtime.journal import ControllerJournal, PlantJournal
    from protocol.runtime.process import new_id
    from protocol.runtime.run_folder import (
        CONTROLLER_JOURNAL,
        CONTROLLER_TRACE,
        PLANT_JOURNAL,
        PLANT_TRACE,
    )
    from protocol.runtime.trace import TraceWriter
    from protocol.streams import CIPHER, COIN, noise, symbols

    watch = Stopwatch()
    law = make_law(scenario, cached_design(scenario))
    fingerprint = scenario.fingerprint()
    with (
        ControllerJournal(folder / CONTROLLER_JOURNAL, fingerprint) as sender_journal,
        PlantJournal(folder / PLANT_JOURNAL, fingerprint) as plant_journal,
    ):
        sender_trace = TraceWriter(folder / CONTROLLER_TRACE, "controller", {})
        plant_trace = TraceWriter(folder / PLANT_TRACE, "plant", {})
        sender_journal.enqueue("bench", MESSAGE)
        sender = Sender(
            rules_of(scenario),
            lambda x: watch.time("controller: law", lambda: law.candidates(x)),
            sender_journal,
            symbols(None, CIPHER),
            new_id(),
        )
        plant = Plant(
            scenario,
            new_id(),
            symbols(None, COIN),
            noise(None, scenario.n),
            first_record(scenario, new_id()),
            "",
        )
        receiver = plant.receiver
        said: ControllerHello | None = sender.greeting()
        while not receiver.accepted:
            assert said is not None
            receiver.heard_controller(said, new_id())
            said = sender.heard_plant(receiver.hello()).reply
        sender_journal.save(sender.record)
        plant_journal.save(receiver.record)
        reported = receiver.measurement().wire()

        def settle() -> None:
            settled = sender.settle()
            if settled.transition is not None:
                sender_trace.write(settled.transition.as_event())
            sender_journal.stage(sender.record)

        def count(move: Move) -> None:
            effects = plant.count(move).effects
            assert effects is not None
            plant_trace.write(effects.transition.as_event())
            plant_journal.stage(receiver.record)

        for _ in range(steps):
            time.sleep(pause_s)
            measurement = watch.time(
                "controller: parse the measurement",
                lambda body=reported: Measurement.model_validate_json(body),  # type: ignore[misc]
            )
            done = watch.time(
                "controller: test, decide, offer",
                lambda message=measurement: sender.measured(message),  # type: ignore[misc]
            )
            watch.take_off("controller: test, decide, offer", "controller: law")
            assert done.offer is not None
            offered = watch.time(
                "controller: dump the offer",
                lambda message=done.offer: message.wire(),  # type: ignore[misc]
            )
            watch.time(
                "controller: journal",
                lambda heard=reported, said=offered: sender_journal.append(heard, said),  # type: ignore[misc]
            )
            watch.time(WHILE_WAITING + "controller: count and trace", settle)
            time.sleep(pause_s)
            offer = watch.time(
                "plant: parse the offer",
                lambda body=offered: Offer.model_validate_json(body),  # type: ignore[misc]
            )
            receiver.check(offer)
            move = watch.time(
                "plant: step",
                lambda message=offer: plant.move(message),  # type: ignore[misc]
            )
            reported = watch.time(
                "plant: dump the measurement",
                lambda x=move.x_next: receiver.moved(x).wire(),  # type: ignore[misc]
            )
            watch.time(
                "plant: journal",
                lambda heard=offered, it=move, said=reported: plant_journal.append(  # type: ignore[misc]
                    heard, said, it.coin
                ),
            )
            watch.time(
                WHILE_WAITING + "plant: count and trace",
                lambda it=move: count(it),  # type: ignore[misc]
            )
        sender_trace.close()
        plant_trace.close()
    return watch.medians_us()


def _statuses(scenario: "Scenario", folder: Path, steps: int = 200) -> dict[str, float]:
    """Microseconds of one status of the plant and of the controller, in the middle of a run.

    Both services run over a bus in memory, the plant in a thread of its own.
    """
    import logging

    from controller_service.laws.paper import make_law
    from controller_service.service import ControllerConfig, ControllerService
    from controller_service.sets.design import cached_design
    from plant_service.service import PlantConfig, PlantService
    from protocol.runtime.memory_bus import MemoryBus, MemoryHub
    from protocol.runtime.process import Pace, logger

    logs = [logger(name) for name in ("plant", "controller")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.WARNING)
    field, ops = MemoryHub(), MemoryHub()
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
            plant = PlantService(config, MemoryBus(field), MemoryBus(ops), threading.Event())
            plant.run()
            time_status("plant", lambda: plant.status(time.monotonic()))
        finally:
            stopping.set()

    controller_config = ControllerConfig(scenario, law, folder, "loop", message=MESSAGE)
    controller = ControllerService(controller_config, MemoryBus(field), MemoryBus(ops), stopping)
    time_status("controller", controller.status)
    thread = threading.Thread(target=run_plant)
    thread.start()
    controller.run()
    thread.join()
    for log, level in zip(logs, levels, strict=True):
        log.setLevel(level)
    return times
