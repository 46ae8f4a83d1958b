"""Both services' ends in one process, with their files on disk: a run's folder to be checked.

Only time and network are make-believe. Journals, traces, statuses and key stores are the services'
own, opened as the services open them; a capture has all that was on the field bus. So a test can
kill an end at any of its ports, spoil a file between two lives, and ask ``wyner check``.
"""

import base64
import logging
import time
import tomllib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, Final, Literal

from attacker_service.relay import Rewriter
from controller_service.core import ControllerCore
from controller_service.service import ControllerConfig, open_controller
from plant_service.attacked import AttackedPlant
from plant_service.core import PlantCore
from plant_service.service import PlantConfig, open_plant
from protocol.link.events import Event
from protocol.link.peer import Actions, Peer
from protocol.messages import FIELD, Message, Offer, SendCommand
from protocol.scenario import Attack, parse_scenario
from protocol.secret.tasks import Task
from runtime.health_files import HealthFiles
from runtime.keys.asking import Asker
from runtime.keys.key_maker import KeyMaker, work
from runtime.keys.sealed_book import SealedBook
from runtime.pace import Pace
from runtime.perform import Crashed, CrashingPorts, perform
from runtime.ports import Files, LoopPorts
from runtime.recording import TraceWriter
from runtime.run_folder import CAPTURE, PLANT_TRACE, SCENARIO
from tap_service.capture.recording import mirror_line
from tests.support.giving import ask
from tests.support.mail import Mail, mail
from tests.support.small_run import SCENARIOS, kill, law_of
from tests.support.traces import read_trace
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

Side = Literal["plant", "controller"]

SIDES: Final[tuple[Side, Side]] = ("plant", "controller")
ASK_EVERY: Final = 16
"""Things that happen between two questions about keys."""

ASK_S: Final = 0.02

QUIET_S: Final = 60.0
"""Virtual seconds without a transition after which a loop is stuck."""

log = logging.getLogger("recorded loop")


@dataclass
class _Publisher:
    """Puts what an end says into the other's mail, and on record."""

    loop: "RecordedLoop"
    side: Side
    kind: type[Message]

    def put(self, payload: bytes) -> None:
        self.loop.said(self.side, Mail(self.kind, payload))


class _Ports(CrashingPorts):
    """Ports of a process that dies so many things after an event's turn has come."""

    since: str = ""
    after = 0

    def trace(self, event: Event) -> None:
        """Die, or trace."""
        if self.since == event.as_event()["event"]:
            self.since = ""
            self.crash_at(after=self.after)
        super().trace(event)


@dataclass
class _End:
    endpoint: Peer
    peer: Peer
    """The same, or with its messages guarded."""
    files: Files
    ports: _Ports
    key_maker: KeyMaker | None
    tasks: deque[Task]
    """They wait for the keeper, as they do in a service."""
    asker: Asker | None


class RecordedLoop:
    """One loop whose run is kept in ``folder``: of the shipped scenario ``name`` and ``more``.

    Parameters
    ----------
    folder : Path
        New, or that of a run to go on with.
    message : bytes
        The controller's first.
    name, more : str
    pace : str
        ``realtime``: a step takes its period, and the ends ask each other about keys as often as
        the services do. ``fast``: lock-step, and they ask all the time.
    attack : Attack, optional
        At the plant's sensor or actuator.

    Attributes
    ----------
    relay : Rewriter, optional
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
    ) -> None:
        self._pace = Pace(pace)
        self._attack = attack
        self.relay: Rewriter | None = None
        self.folder = folder
        self.now = 0.0
        self._steps = 0
        self.lives = dict.fromkeys(SIDES, 0)
        self.ciphers: dict[tuple[str, int], int] = {}
        self._message = message
        text = (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8") + more
        self.scenario = parse_scenario(tomllib.loads(text), name)
        self._law = law_of(name)[1]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / SCENARIO).write_text(text, encoding="utf-8")
        view = {"view": "both", "loss": 0.0, "noise": 0.0, "quantise": 0.0, "delay": 0}
        header = {"capture_version": 2, "part": 0, "view": view}
        self._capture = TraceWriter(folder / CAPTURE, "tap", header)
        self._mail: dict[Side, deque[Mail]] = {side: deque() for side in SIDES}
        self.ends: dict[Side, _End] = {}
        for side in SIDES:
            self.start(side)

    # --- lives ------------------------------------------------------------------------------------

    def start(self, side: Side, *, clear_alarm: bool = False) -> None:
        """Begin a life of one end, from what its files hold."""
        self.lives[side] += 1
        if side == "plant":
            plant = PlantConfig(self.scenario, self.folder, "loop", self._pace, attack=self._attack)
            endpoint, files = open_plant(plant, self.now)
        else:
            made = ControllerConfig(
                self.scenario,
                self.folder,
                "loop",
                self._law,
                self._message,
                clear_alarm=clear_alarm,
            )
            endpoint, files = open_controller(made)  # type: ignore[assignment]
        peer: Peer = files.guarded or endpoint
        publishers = {kind: _Publisher(self, side, kind) for kind in peer.says}
        tasks: deque[Task] = deque()
        key_maker = None if files.key_maker is None else files.key_maker.open()
        health = HealthFiles(files.health, log)
        ports = LoopPorts(
            files,
            publishers,  # type: ignore[arg-type]
            log,
            lambda status: health.write(status, time.monotonic()),
            tasks.append,
        )
        asker = None if key_maker is None else Asker(SealedBook(key_maker.store))
        self.ends[side] = _End(endpoint, peer, files, _Ports(ports), key_maker, tasks, asker)
        self._do(side, peer.start)

    def kill(self, side: Side) -> None:
        """As SIGKILL: what was written stays, what was on its way to it is lost."""
        end = self.ends.pop(side)
        kill(end.files.trace)
        end.files.journal.close()
        if end.key_maker is not None:
            end.key_maker.store.close()
        self._mail[side].clear()

    def stop(self) -> None:
        """Let both ends say their last word."""
        for side, end in tuple(self.ends.items()):
            self._do(side, end.peer.stop)
            end.files.close()
            if end.key_maker is not None:
                end.key_maker.store.close()
        self._capture.close()

    def queue(self, identifier: str, payload: bytes) -> None:
        """The operator hands over a message."""
        command = SendCommand(id=identifier, payload=payload)
        self._mail["controller"].append(mail(command))

    def crash_at(self, side: Side, after: int, since: str = "") -> None:
        """Let an end die after so many things asked of its ports, from now or from an event on.

        The event, by its name in the trace, is the first of them: 0 is before it is traced, 1
        before it is saved.
        """
        ports = self.ends[side].ports
        if not since:
            ports.crash_at(after=after)
        else:
            ports.since, ports.after = since, after

    # --- what happens -----------------------------------------------------------------------------

    def said(self, side: Side, message: Mail) -> None:
        """A message on its way: the tap hears it, and the other end if it is for it."""
        if message.kind is Offer:
            self._one_cipher(Offer.model_validate_json(message.payload))
        if message.kind in FIELD:
            line = mirror_line(self._t_ns(), message.kind.topic, message.payload)
            self._capture.lines.append(line)
            message = self._attacked(message)
        partner: Side = "controller" if side == "plant" else "plant"
        end = self.ends.get(partner)
        if end is not None and message.kind in end.peer.hears:
            self._mail[partner].append(message)

    def _attacked(self, message: Mail) -> Mail:
        """A message of the field bus as it arrives; an attack at the plant hears it there."""
        plant = self.ends["plant"].endpoint.plant if "plant" in self.ends else None  # type: ignore[attr-defined]
        if isinstance(plant, AttackedPlant):
            plant.heard.append((message.kind.topic, message.payload))
        if self.relay is None:
            return message
        kind: Any = message.kind
        return Mail(kind, self.relay.rewritten(kind, message.payload))

    @property
    def controller(self) -> ControllerCore:
        """The controller's end of the link."""
        found = self.ends["controller"].endpoint
        assert isinstance(found, ControllerCore)
        return found

    @property
    def plant(self) -> PlantCore:
        """The plant's end of the link."""
        found = self.ends["plant"].endpoint
        assert isinstance(found, PlantCore)
        return found

    def _one_cipher(self, offer: Offer) -> None:
        """A transition's cipher symbol is one, or a key symbol meets two message symbols."""
        at = offer.session, self.controller.reported
        first = self.ciphers.setdefault(at, offer.cipher)
        assert first == offer.cipher, f"transition {at}: offered ciphers {first}, {offer.cipher}"

    def _t_ns(self) -> int:
        return round(self.now * 1e9)

    def _do(self, side: Side, act: Callable[[float], Actions]) -> None:
        """Let an end act; one that dies over it is started again at once."""
        end = self.ends[side]
        try:
            perform(act(self.now), end.peer, end.ports)
        except Crashed:
            self.kill(side)
            self.start(side)

    def step(self) -> None:
        """Deliver a message to each end, or let time pass."""
        quiet = True
        self._steps += 1
        defence = self.scenario.defence
        takes_keys = defence.keyed or defence.messages != "clear"
        timed = self._pace.factor is not None
        if takes_keys and not timed and self._steps % ASK_EVERY == 0:
            self.now += ASK_S
            self._ask(float(self._steps))
        for side in SIDES:
            end = self.ends[side]
            if end.tasks and end.key_maker is not None:
                done = work(end.key_maker, end.tasks.popleft())
                self._do(side, lambda now, e=end, d=done: e.peer.key_task_done(d, now))  # type: ignore[misc]
                quiet = False
            elif self._mail[side]:
                kind, payload = self._mail[side].popleft()
                self._do(side, lambda now, e=end, m=(kind, payload): e.peer.receive(*m, now))  # type: ignore[misc]
                quiet = False
        if quiet:
            due = {side: end.peer.wake_at() for side, end in self.ends.items()}
            side = min(due, key=lambda s: due[s])
            askers = [e.asker for e in self.ends.values() if takes_keys and timed and e.asker]
            asks_at = min((asker.wake_at() for asker in askers), default=inf)
            self.now = max(self.now, min(asks_at, due[side]))
            if asks_at <= due[side]:
                self._ask(self.now)
            else:
                self._do(side, self.ends[side].peer.wake)

    def _ask(self, now: float) -> None:
        """Each end asks the other what may be given, as it does beside the loop."""
        for mine, theirs in (SIDES, SIDES[::-1]):
            asker, partner = self.ends[mine].asker, self.ends[theirs].asker
            if asker is not None and partner is not None:
                ask(asker, partner, now)

    def run(self, over: Callable[[], bool]) -> None:
        """Go on until ``over``; an error where nothing moves any more."""
        moved, at = -1, self.now
        while not over():
            self.step()
            if (transitions := self.transitions) != moved:
                moved, at = transitions, self.now
            assert self.now - at < QUIET_S, "the loop stands still"

    @property
    def transitions(self) -> int:
        """Transitions that the plant has made in its session."""
        return self.ends["plant"].endpoint.record.transitions  # type: ignore[attr-defined,no-any-return]

    @property
    def received(self) -> list[bytes]:
        """What the plant's journal has received."""
        return self.ends["plant"].files.journal.inbox()  # type: ignore[attr-defined,no-any-return]

    @property
    def recovered(self) -> list[bytes]:
        """What the plant's trace says that it has recovered."""
        events = read_trace(self.folder / PLANT_TRACE).of("recovered")
        return [base64.b64decode(event["payload"]) for event in events]

    @property
    def delivered(self) -> int:
        """Messages that the controller knows to be delivered."""
        return self.controller.record.message

    def wrong(self) -> list[str]:
        """What ``wyner check`` says of the run, once it is over."""
        results = check(read_evidence(self.folder))
        return [f"{r.check.name}: {r.counter.first}" for r in results if r.result == "FAIL"]
