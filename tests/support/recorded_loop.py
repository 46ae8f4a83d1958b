"""Both services' ends in one process, with their files on disk: a run's folder to be checked.

Only time and network are make-believe. Journals, traces and statuses are the services' own, opened
as the services open them; a capture has all that was on the field bus. So a test can
kill an end at any of its ports, spoil a file between two lives, and ask ``wyner check``.
"""

import base64
import logging
import time
import tomllib
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from attacker_service.attacker import Attacker
from controller_service.service import ControllerConfig, open_controller
from plant_service.plant import FilteredPlant
from plant_service.service import PlantConfig, open_plant
from protocol.messages import FIELD, Message, Offer, SendCommand
from protocol.scenario import Attack, parse_scenario
from protocol.secret.blocks import ClosedBlock
from runtime.health_files import HealthFiles
from runtime.pace import Pace
from runtime.ports import LoopPorts
from runtime.recording import TraceWriter
from runtime.run_folder import CAPTURE, PLANT_TRACE, SCENARIO
from tap_service.capture.recording import mirror_line
from tests.support.controller_in_hand import reported
from tests.support.mail import Mail, mail
from tests.support.small_run import SCENARIOS, kill, law_of
from tests.support.traces import read_trace
from tests.support.two_ends import SIDES, Alive, MortalPorts, Name, TwoEnds
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

log = logging.getLogger("recorded loop")


@dataclass
class _Publisher:
    """Puts what an end says into the other's mail, and on record."""

    loop: "RecordedLoop"
    side: Name
    kind: type[Message]

    def put(self, payload: bytes) -> None:
        self.loop.said(self.side, Mail(self.kind, payload))


class RecordedLoop(TwoEnds):
    """One loop whose run is kept in ``folder``: of the shipped scenario ``name`` and ``more``.

    Parameters
    ----------
    folder : Path
        New, or that of a run to go on with.
    message : bytes
        The controller's first.
    name, more : str
    change : tuple of str
        A piece of the shipped scenario, and what stands there instead.
    pace : str
        ``realtime``: a step takes its period. ``fast``: lock-step.
    attack : Attack, optional
        One on the bus needs a :attr:`relay` besides.

    Attributes
    ----------
    relay : Attacker, optional
        Through which messages of the field bus pass.
    """

    def __init__(
        self,
        folder: Path,
        message: bytes = b"",
        name: str = "sustained",
        more: str = "",
        *,
        pace: str = "fast",
        attack: Attack | None = None,
        change: tuple[str, str] = ("", ""),
    ) -> None:
        super().__init__()
        self._pace = Pace(pace)
        self._attack = attack
        self.relay: Attacker | None = None
        self.folder = folder
        self.ciphers: dict[tuple[str, int], int] = {}
        self._message = message
        text = (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8").replace(*change) + more
        self.scenario = parse_scenario(tomllib.loads(text), name)
        self._law = law_of(name)[1]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / SCENARIO).write_text(text, encoding="utf-8")
        view = {"view": "both", "loss": 0.0, "noise": 0.0, "quantise": 0.0, "delay": 0}
        header = {"capture_version": 2, "part": 0, "view": view}
        self._capture = TraceWriter(folder / CAPTURE, "tap", header)
        self._clear_alarm = False
        for side in SIDES:
            self.start(side)

    # --- lives ------------------------------------------------------------------------------------

    def start(self, side: Name, *, clear_alarm: bool = False) -> None:
        """Begin a life of one end, from what its files hold."""
        self._clear_alarm = clear_alarm
        super().start(side)

    def open(self, side: Name) -> Alive:
        core: Any
        if side == "plant":
            plant = PlantConfig(self.scenario, self.folder, "loop", self._pace, attack=self._attack)
            core, files = open_plant(plant, self.now)
        else:
            made = ControllerConfig(
                self.scenario,
                self.folder,
                "loop",
                self._law,
                self._message,
                clear_alarm=self._clear_alarm,
            )
            core, files = open_controller(made)
        publishers = {kind: _Publisher(self, side, kind) for kind in core.says}
        closed = deque[ClosedBlock]()
        health = HealthFiles(files.health, log)
        ports = LoopPorts(
            files,
            publishers,  # type: ignore[arg-type]
            log,
            lambda status: health.write(status, time.monotonic()),
            closed.append,
        )
        return Alive(core, MortalPorts(ports), files, closed)

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

    def said(self, side: Name, message: Mail) -> None:
        """A message on its way: the tap hears it, and the other end if it is for it."""
        if message.kind is Offer:
            self._one_cipher(Offer.model_validate_json(message.payload))
        if message.kind in FIELD:
            line = mirror_line(self._t_ns(), message.kind.topic, message.payload)
            self._capture.put(line)
            message = self._attacked(message)
        super().said(side, message)

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

    def _one_cipher(self, offer: Offer) -> None:
        """A transition's cipher symbol is one, or a key symbol meets two message symbols."""
        at = offer.session, reported(self.controller)
        first = self.ciphers.setdefault(at, offer.cipher)
        assert first == offer.cipher, f"transition {at}: offered ciphers {first}, {offer.cipher}"

    def _t_ns(self) -> int:
        return round(self.now * 1e9)

    def advance(self, transitions: int) -> None:
        """Go on until the plant has made so many more in its session."""
        target = self.transitions + transitions
        self.run(lambda: self.transitions >= target)

    @property
    def transitions(self) -> int:
        """Transitions that the plant has made in its session."""
        return self.plant.state.record.link.transitions

    @property
    def received(self) -> list[bytes]:
        """What the plant's journal has received last, if it has received a message."""
        last = self.ends["plant"].files.journal.last_message()
        return [] if last is None else [last]

    @property
    def recovered(self) -> list[bytes]:
        """What the plant's trace says that it has recovered."""
        events = read_trace(self.folder / PLANT_TRACE).of("recovered")
        return [base64.b64decode(event["payload"]) for event in events]

    @property
    def delivered(self) -> int:
        """Messages that the controller knows to be delivered."""
        return self.controller.state.record.frame.message

    def wrong(self) -> list[str]:
        """What ``wyner check`` says of the run, once it is over."""
        return [str(finding) for finding in check(read_evidence(self.folder))]
