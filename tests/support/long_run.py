"""A run of many steps in lock-step: both ends as the services open them, and a tap on record."""

import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING

from controller_service.laws.registry import cached_design, make_law
from controller_service.service import ControllerConfig, open_controller
from plant_service.service import PlantConfig, open_plant
from protocol.link.events import lines
from protocol.messages import FIELD, ControllerHello, Measurement, Offer, PlantHello
from protocol.secret.extractor import extracted
from runtime.pace import Pace
from runtime.perform import perform
from runtime.recording import Bounds
from runtime.run_folder import CAPTURE, SCENARIO
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from tap_service.capture.recording import RotatingLog

if TYPE_CHECKING:
    from protocol.link.effects import Notice, Save
    from protocol.link.endpoint import Endpoint
    from protocol.link.events import Event
    from protocol.messages import Message, Status
    from protocol.secret.blocks import ClosedBlock
    from runtime.ports import Files

HEARS: "dict[str, tuple[type[Message], ...]]" = {
    "controller": (Measurement, PlantHello),
    "plant": (Offer, ControllerHello),
}


class Ports:
    """An end's ports, and what it said since the partner last listened."""

    def __init__(self, files: "Files", tap: RotatingLog) -> None:
        self.files = files
        self.mail: list[tuple[type[Message], bytes]] = []
        self.blocks: list[ClosedBlock] = []
        self._tap = tap

    def save(self, save: "Save") -> None:
        """Keep it in the journal."""
        self.files.journal.save(save)

    def publish(self, message: "Message") -> None:
        """Leave it for the partner, and on record."""
        payload = message.wire()
        self.mail.append((type(message), payload))
        if type(message) in FIELD:
            line = b'{"event":"field","t_ns":%d,"topic":"%s","message":%s}'
            self._tap.write(line % (time.time_ns(), message.topic.encode(), payload))

    def extract(self, block: "ClosedBlock") -> None:
        """Extract it when the step is over."""
        self.blocks.append(block)

    def trace(self, event: "Event") -> None:
        """Write it to the trace."""
        self.files.trace.write(*lines(event))

    def log_notice(self, notice: "Notice") -> None:
        """Nobody reads the log."""

    def health(self, status: "Status") -> None:
        """Nobody asks for the health."""


def make_run(folder: Path, steps: int, name: str = "sustained") -> None:
    """A run of ``steps`` steps, with all that `wyner check` compares."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCENARIO).write_bytes((SCENARIOS / f"{name}.toml").read_bytes())
    scenario = load_scenario(folder / SCENARIO)
    view = {"view": "both", "loss": 0.0, "noise": 0.0, "quantise": 0.0, "delay": 0}
    limits = Bounds(total_bytes=2**40, free_bytes=0)
    tap = RotatingLog(folder / CAPTURE, {"view": view}, limits, logging.getLogger("tap"))
    law = make_law(scenario, cached_design(scenario))
    controller, controller_files = open_controller(
        ControllerConfig(scenario, folder, "loop", law, b"x" * 60_000)
    )
    fast = PlantConfig(scenario, folder, "loop", Pace("fast"))
    plant, plant_files = open_plant(fast, time.monotonic())
    ends: dict[str, tuple[Endpoint, Ports]] = {
        "controller": (controller, Ports(controller_files, tap)),
        "plant": (plant, Ports(plant_files, tap)),
    }
    for endpoint, ports in ends.values():
        perform(endpoint.start(time.monotonic()), ports)
    while plant.state.record.link.k < steps:
        for side, other in (("controller", "plant"), ("plant", "controller")):
            (endpoint, ports), now = ends[side], time.monotonic()
            mail, ends[other][1].mail = ends[other][1].mail, []
            if endpoint.wake_at() <= now:
                perform(endpoint.wake(now), ports)
            for kind, payload in mail:
                if kind in HEARS[side]:
                    perform(endpoint.receive(kind, payload, now), ports)
            while ports.blocks:
                block = extracted(ports.blocks.pop(0))
                perform(endpoint.extracted(block), ports)
    controller_files.close()
    plant_files.close()
    tap.close()
