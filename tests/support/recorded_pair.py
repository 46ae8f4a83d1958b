"""Both services' ends in one process, with their files on disk: a run's folder to be checked.

Only time and network are make-believe. Journals, traces and statuses are the services' own, opened
as the services open them; a capture has all that was on the field bus. So a test can
kill an end at any of its ports, spoil a file between two lives, and ask ``wyner check``.
"""

import json
import logging
import os
import shutil
import time
import tomllib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

from attacker_service.attacker import Attacker
from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from controller_service.service import ControllerConfig, open_controller
from plant_service.plant import FilteredPlant
from plant_service.service import PlantConfig, open_plant
from protocol.link.effects import Effect, Save
from protocol.link.records import Side
from protocol.link.session import rules_of
from protocol.messages import FIELD, Measurement, Message, Offer, SendCommand
from protocol.scenario import AttackTable, Scenario, parse_scenario
from protocol.secret.blocks import ClosedBlock
from runtime.health import HealthFiles
from runtime.pace import Pace
from runtime.ports import LoopPorts
from runtime.recording import Bounds, TraceWriter
from runtime.run_folder import CAPTURE, SCENARIO
from runtime.scenario_file import scenario_of
from tap_service.capture.recording import mirror_line
from tap_service.config import TapConfig
from tests.support.mail import Mail, mail
from tests.support.pair import SIDES, Alive, Mortal, Name, Pair
from tests.support.scenarios import text_of
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

log = logging.getLogger("recorded pair")

Lines = list[dict[str, Any]]

Fault = Literal[
    "none",
    "repeated",
    "offer lost",
    "plant dies",
    "plant forgets",
    "journal copied",
    "journal put back",
    "controller dies",
    "controller forgets",
]
"""What goes wrong in a step; a journal that is copied or put back is the plant's."""


@cache
def law_of(name: str) -> tuple[Scenario, CandidateLaw]:
    """A shipped scenario, and its law."""
    scenario = scenario_of(name)
    return scenario, make_law(scenario, cached_design(scenario))


@dataclass
class _Publisher:
    """Puts what an end says into the other's mail, and on record."""

    pair: "RecordedPair"
    side: Name
    kind: type[Message]

    def put(self, payload: bytes) -> None:
        self.pair.said(self.side, Mail(self.kind, payload))


class _Ports(LoopPorts):
    """The services' ports; messages that arrive are noted."""

    received: list[bytes]

    def do(self, effect: Effect) -> None:
        super().do(effect)
        if isinstance(effect, Save) and effect.received is not None:
            self.received.append(effect.received)


class RecordedPair(Pair):
    """One loop whose run is kept in ``folder``: of the shipped scenario ``name`` and ``more``.

    Parameters
    ----------
    folder : Path
        New, or that of a run to go on with.
    payloads : bytes
        The controller's messages.
    name, more : str
    changes : sequence of tuple of str
        Pieces of the shipped scenario, and what stands there instead.
    pace : str
        ``realtime``: a step takes its period. ``fast``: lock-step.
    attack : AttackTable, optional
        One on the bus needs a :attr:`relay` besides.
    seed : int, optional
        Of coins, covers and disturbances.
    bounds, captured : Bounds, optional
        Of the traces, and of the tap's capture.
    last : int, optional
        The plant's last step.

    Attributes
    ----------
    relay : Attacker, optional
        Through which messages of the field bus pass.
    received : list of bytes
        Messages that have arrived.
    """

    def __init__(
        self,
        folder: Path,
        *payloads: bytes,
        name: str = "sustained",
        more: str = "",
        pace: str = "realtime",
        attack: AttackTable | None = None,
        changes: tuple[tuple[str, str], ...] = (),
        seed: int | None = 1,
        bounds: Bounds | None = None,
        captured: Bounds | None = None,
        last: int | None = None,
    ) -> None:
        self._last = last
        self._pace, self._seed, self._bounds = Pace(pace), seed, bounds or Bounds()
        self._attack = attack
        self.relay: Attacker | None = None
        self.folder = folder
        self.received: list[bytes] = []
        self._message = payloads[0] if payloads else b""
        self._lost: int | None = None  # the step whose offers are lost
        text = text_of(name, *changes) + more
        self.scenario = parse_scenario(tomllib.loads(text), name)
        super().__init__(rules_of(self.scenario))
        self._law = law_of(name)[1]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / SCENARIO).write_text(text, encoding="utf-8")
        header = {"capture_version": 2, **TapConfig(folder, self.scenario.knowledge()).header()}
        self._capture = TraceWriter(folder / CAPTURE, "tap", header, captured)
        self._clear_alarm = False
        for side in SIDES:
            self.start(side)
        self._more = payloads[1:]
        self._hand_over()

    def _hand_over(self) -> None:
        for number, payload in enumerate(self._more, start=1):
            self.hear("controller", mail(SendCommand(id=f"m{number}", payload=payload)))

    # --- lives ------------------------------------------------------------------------------------

    def start(self, side: Name, *, clear_alarm: bool = False) -> None:
        """Begin a life of one end, from what its files hold."""
        self._clear_alarm = clear_alarm
        super().start(side)

    def open(self, side: Name) -> Alive:
        core: Any
        more: Any = {"seed": self._seed, "bounds": self._bounds}
        if side == "plant":
            plant = PlantConfig(
                self.scenario,
                self.folder,
                "loop",
                self._pace,
                self._last,
                attack=self._attack,
                **more,
            )
            core, files = open_plant(plant, self.now)
        else:
            made = ControllerConfig(
                self.scenario,
                self.folder,
                "loop",
                law=self._law,
                message=self._message,
                clear_alarm=self._clear_alarm,
                **more,
            )
            core, files = open_controller(made)
        publishers = {kind: _Publisher(self, side, kind) for kind in core.sends}
        closed = deque[ClosedBlock]()
        health = HealthFiles(files.health, log)
        ports = _Ports(
            files,
            publishers,  # type: ignore[arg-type]
            log,
            lambda status: health.write(status, time.monotonic()),
            closed.append,
        )
        ports.received = self.received
        return Alive(core, Mortal(ports.do), files, closed)

    def die(self, side: Name) -> None:
        """It is killed, and comes back at once."""
        self.kill(side)
        super().die(side)

    def kill(self, side: Name) -> None:
        """As SIGKILL: what was written stays, what was on its way to it is lost."""
        end = self.ends.pop(side)
        kill(end.files.trace)
        end.files.journal.close()
        self.mail["plant" if side == "plant" else "controller"].clear()

    def restart(self, side: Side, journal: Literal["lost", "old"]) -> None:
        """Kill an end; its journal is gone when it comes back, or is as it was copied."""
        self.kill(side)
        for path in (self.folder / side).glob("journal*"):
            path.unlink()
        if journal == "old":
            shutil.copytree(self._copy(side), self.folder / side, dirs_exist_ok=True)
        self.start(side)

    def copy(self, side: Side) -> None:
        """Keep a copy of an end's journal as it is now."""
        shutil.rmtree(self._copy(side), ignore_errors=True)
        self._copy(side).mkdir()
        for path in (self.folder / side).glob("journal*"):
            shutil.copy(path, self._copy(side))

    def _copy(self, side: Side) -> Path:
        return self.folder.with_name(f"{self.folder.name}-{side}-copy")

    def restart_tap(self) -> None:
        """The tap is killed, and goes on with its capture."""
        kill(self._capture)
        self._capture = TraceWriter(self.folder / CAPTURE, "tap", {})

    def stop(self) -> None:
        """Let both ends say their last word."""
        for side, end in tuple(self.ends.items()):
            self.do(side, end.endpoint.stop)
            end.files.close()
        self._capture.close()

    def queue(self, identifier: str, payload: bytes) -> None:
        """The operator hands over a message."""
        command = SendCommand(id=identifier, payload=payload)
        self.mail["controller"].append(mail(command))

    # --- what happens -----------------------------------------------------------------------------

    def post(self, side: Name, message: Mail) -> None:
        """A message on its way: the tap hears it, and the other end if it is for it."""
        lost = message.kind is Offer and self._lost == json.loads(message.payload)["k"]
        if message.kind in FIELD:
            line = mirror_line(self._t_ns(), message.kind.topic, message.payload)
            self._capture.put(line)
            message = self._attacked(message)
        if not lost:
            super().post(side, message)

    def _attacked(self, message: Mail) -> Mail:
        """A message of the field bus as it arrives; an attack at the plant hears it there."""
        plant = self.plant.stepper.plant if "plant" in self.ends else None
        kind: Any = message.kind
        if isinstance(plant, FilteredPlant):
            for one in plant.filters:
                one.incoming(kind, message.payload)
        if self.relay is None:
            return message
        return Mail(kind, self.relay.incoming(kind, message.payload))

    def _t_ns(self) -> int:
        return round(self.now * 1e9)

    def step(self, fault: Fault = "none") -> None:
        """Go on until the plant has made its next step, whatever goes wrong in it."""
        if fault == "controller dies":
            self.crash_at("controller", "saving")
        elif fault == "plant forgets":
            self.restart("plant", "lost")
        elif fault == "controller forgets":
            self.restart("controller", "lost")
            self._hand_over()
        elif fault == "journal copied":
            self.copy("plant")
        elif fault == "journal put back":
            self.restart("plant", "old")
        k = self.plant.state.record.link.k
        self._lost = k if fault == "offer lost" else None
        if fault == "repeated":
            self.run(lambda: any(m.kind is Measurement for m in self.mail["controller"]))
            self.hear("controller", self.mail["controller"][-1])
        self.run(lambda: self.plant.state.record.link.k != k)
        if fault == "plant dies":  # what it counted last is counted again
            self.die("plant")
        for side in SIDES:
            self.crash_at(side)

    def steps(self, count: int, faults: dict[int, Fault] | None = None) -> None:
        """Make steps, with what goes wrong in some of them (by number within this call)."""
        for i in range(count):
            self.step((faults or {}).get(i, "none"))

    def until_received(self, messages: int) -> None:
        """Go on until so many messages have arrived."""
        self.run(lambda: len(self.received) >= messages)

    @property
    def transitions(self) -> int:
        """Transitions that the plant has made in its session."""
        return self.plant.state.record.link.transitions

    @property
    def delivered(self) -> int:
        """Messages that the controller knows to be delivered."""
        return self.controller.state.record.frame.message

    def wrong(self) -> list[str]:
        """What ``wyner check`` says of the run, once it is over."""
        return [str(finding) for finding in check(read_evidence(self.folder))]


def make_run(folder: Path, steps: int, name: str = "sustained") -> None:
    """A run of so many steps in lock-step, of one long message."""
    bounds = Bounds(total_bytes=2**40, free_bytes=0)
    loop = RecordedPair(folder, b"x" * 60_000, name=name, pace="fast", bounds=bounds)
    loop.run(lambda: loop.plant.state.record.link.k >= steps)
    loop.stop()


def kill(writer: TraceWriter) -> None:
    """Close without an end mark."""
    with patch.object(os, "write", side_effect=OSError):
        writer.close()


def read_lines(path: Path) -> Lines:
    """A trace or capture as JSON, to be changed."""
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def write_lines(path: Path, lines: Lines) -> None:
    """Write it back, as compact as it was."""
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    path.write_text(text)


def edit(path: Path, change: Callable[[Lines], object]) -> None:
    """Change the lines of a recording in place."""
    lines = read_lines(path)
    change(lines)
    write_lines(path, lines)
