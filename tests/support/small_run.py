"""Makes the folder of a run without processes: both pure ends, their traces and a capture.

What a network and dying processes do to a run is called for step by step, so that a test knows what
happened. The traces are written as the services write them. Without shell, clock and stores a run
of known coins takes milliseconds; one with them is :mod:`tests.support.recorded_loop`'s.
"""

import base64
import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal
from zlib import crc32

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from plant_service.opening import first_record
from plant_service.plant import Coin, Disturbances, LinearModel
from protocol.link.events import MET, NEW_JOURNAL, RESUMED, UNKNOWN_THERE, SessionBegan, lines
from protocol.link.fallback import Fallback
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.session import CountedTransition, rules_of
from protocol.link.step import IDLE, Step
from protocol.messages import ControllerHello, Measurement, Message, Offer
from protocol.scenario import Scenario, parse_scenario
from protocol.streams import CIPHER, COIN, DISTURBANCE, SeededSymbols, Stream
from runtime.recording import Bounds, TraceWriter
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE
from tests.support.controller_in_hand import ControllerInHand
from tests.support.plant_in_hand import PlantInHand

SCENARIOS: Final = Path(__file__).resolve().parents[2] / "runtime" / "scenarios"

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


@cache
def law_of(name: str) -> tuple[Scenario, CandidateLaw]:
    data = tomllib.loads((SCENARIOS / f"{name}.toml").read_text())
    scenario = parse_scenario(data, name)
    return scenario, make_law(scenario, cached_design(scenario))


class Queue:
    """The controller's messages."""

    def __init__(self, payloads: tuple[bytes, ...] = ()) -> None:
        self.payloads = list(payloads)

    @property
    def queued(self) -> int:
        return len(self.payloads)

    def payload(self, number: int) -> bytes | None:
        return self.payloads[number] if number < len(self.payloads) else None

    def crc_of(self, identifier: str) -> int | None:
        payload = self.payload(int(identifier)) if identifier.isdigit() else None
        return None if payload is None else crc32(payload)

    def identifier(self, number: int) -> str:
        return str(number)


class SmallRun:
    """A run of the shipped scenario ``name``, its text changed by ``changes``."""

    def __init__(
        self,
        folder: Path,
        payloads: tuple[bytes, ...] = (b"hi",),
        *,
        name: str = "sustained",
        changes: tuple[tuple[str, str], ...] = (),
        seed: int = 1,
        bounds: Bounds | None = None,
    ) -> None:
        self.folder = folder
        self._bounds = bounds
        self._seed = seed
        self._lives = 0
        text = (SCENARIOS / f"{name}.toml").read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scenario.toml").write_text(text)
        self.scenario = parse_scenario(tomllib.loads(text), name)
        self._law = law_of(name)[1]
        self._plant_trace = self._writer("plant")
        self._trace = self._writer("controller")
        view = {"view": "both", "loss": 0.0, "noise": 0.0, "quantise": 0.0, "delay": 0}
        self._view = {"capture_version": 2, "part": 0, "view": view}
        self._seen: Lines = []
        self._queue = Queue(payloads)
        self._t_ns = 0
        self.received: list[bytes] = []
        self._copied: tuple[PlantRecord, str, Offer]
        self._tell_queue()
        self.sender = self._new_sender(None)
        record = first_record(self.scenario, "0" * 15 + "1")
        self._symbols = ""
        self.receiver = self._new_plant(record, NEW_JOURNAL)
        self._meet()

    def steps(self, count: int, faults: dict[int, Fault] | None = None) -> None:
        """Make steps, with what goes wrong in some of them (by number within this call)."""
        for i in range(count):
            self.step((faults or {}).get(i, "none"))

    def until_received(self, messages: int, limit: int = 5000) -> None:
        """Make steps until the plant has that many messages."""
        for _ in range(limit):
            if len(self.received) >= messages:
                return
            self.step()
        raise AssertionError(f"{len(self.received)} messages after {limit} steps")

    def close(self) -> None:
        """End the recordings."""
        capture = TraceWriter(self.folder / CAPTURE, "tap", self._view)
        for line in self._seen:
            capture.write(line)
        for writer in (self._plant_trace, self._trace, capture):
            writer.close()

    def step(self, fault: Fault = "none") -> None:
        """One step of the plant."""
        if fault == "controller forgets":
            kill(self._trace)
            self._trace = self._writer("controller")
            self._tell_queue()
            self.sender = self._new_sender(None)
        if fault == "controller dies":
            before = self.sender.record
            self._measure()
            kill(self._trace)
            self._trace = self._writer("controller")
            self.sender = self._new_sender(before)
            self._capture_back()
        if fault == "plant forgets":
            session = f"{int(self.receiver.record.session.id, 16) + 1:016x}"
            self._symbols = ""
            self.receiver = self._new_plant(first_record(self.scenario, session), NEW_JOURNAL)
        if fault == "journal put back":  # the plant's, as it was copied; it holds a step
            record, self._symbols, offer = self._copied
            self.receiver = self._new_plant(record, RESUMED)
            self.receiver.takes(offer)
            self._counted(saved=True)
        if fault in ("plant forgets", "journal put back", "controller forgets", "controller dies"):
            self._meet()
        offer = self._measure()
        if fault == "journal copied":
            self._copied = (self.receiver.record, self._symbols, offer)
        if fault == "repeated":
            assert self._measure() == offer
        if fault == "offer lost":
            self._miss()
            return
        if fault == "plant dies":
            record = self.receiver.record
            self.receiver.takes(offer)
            self._counted()
            step = self.receiver.step
            assert step is not None
            self.receiver = self._new_plant(record, RESUMED, step.step)
            self._counted(saved=True)
            self._meet()
            return
        assert self.receiver.check(offer) == "current"
        self.receiver.takes(offer)
        self._counted(saved=True)

    def _measure(self) -> Offer:
        measurement = self.receiver.measurement()
        self._see(measurement)
        effects = self.sender.measured(measurement)
        assert effects.offer is not None
        if effects.append:
            settled = self.sender.finish_step()
            if settled.transition is not None:
                self._trace.write(settled.transition.as_event())
            if settled.delivered is not None:
                self._tell("delivered", int(settled.delivered))
        self._see(effects.offer)
        return effects.offer

    def _counted(self, *, saved: bool = False) -> None:
        """Trace what the plant counted; ``saved``: what came of it was saved, too."""
        for event in self.receiver.events:
            if isinstance(event, CountedTransition):
                told = lines(event)
                self._plant_trace.write(*told if saved else told[:1])
                if saved and event.recovered is not None:
                    self.received.append(event.recovered)
            elif saved:
                assert isinstance(event, SessionBegan), event
        for save in self.receiver.saved if saved else ():
            assert isinstance(save.record, PlantRecord)
            self._symbols = (self._symbols + save.symbols)[: save.record.frame.stored]

    def _miss(self) -> None:
        self._plant_trace.write(self.receiver.miss().as_event())

    def _meet(self) -> None:
        """Hellos until the session is taken up, ending it where the journals do not fit."""
        self.receiver.look_around()
        said: ControllerHello | None = self.sender.greeting()
        for _ in range(4):
            assert said is not None
            new = f"{int(self.receiver.record.session.id, 16) + 1:016x}"
            outcome = self.receiver.heard_controller(said, new)
            if outcome == "accepted":
                return
            if outcome == "ended":
                self._symbols = ""
                self._plant_trace.write(
                    {"event": "session", "session": new, "reason": UNKNOWN_THERE}
                )
            effects = self.sender.heard_plant(self.receiver.hello())
            if effects.save:
                session = self.sender.record.session.id
                self._trace.write({"event": "session", "session": session, "reason": MET})
            said = effects.reply
        raise AssertionError("the two ends did not meet")

    def _new_sender(self, record: ControllerRecord | None) -> ControllerInHand:
        self._lives += 1
        return ControllerInHand(
            rules_of(self.scenario),
            self._law.candidates,
            f"{self._lives:016x}",
            record,
            messages=self._queue,
            fresh=SeededSymbols(self._seed, CIPHER, run=self._lives),
        )

    def _new_plant(self, record: PlantRecord, reason: str, step: Step = IDLE) -> PlantInHand:
        if self._lives > 1:
            kill(self._plant_trace)
            self._plant_trace = self._writer("plant")
        self._lives += 1
        self._plant_trace.write(
            {"event": "session", "session": record.session.id, "reason": reason}
        )
        noise = Stream(self._seed, DISTURBANCE, width=self.scenario.n, run=self._lives)
        coins = SeededSymbols(self._seed, COIN, run=self._lives)
        return PlantInHand(
            rules_of(self.scenario),
            f"{self._lives:016x}",
            record,
            self._symbols,
            step=step,
            plant=LinearModel(self.scenario, Disturbances(self.scenario, noise)),
            coin=Coin(coins, self.scenario.secrecy.candidates),
            fallback=Fallback.of(self.scenario).input,
        )

    def _writer(self, side: str) -> TraceWriter:
        path = PLANT_TRACE if side == "plant" else CONTROLLER_TRACE
        return TraceWriter(self.folder / path, side, self.scenario.identity(), self._bounds)

    def _tell_queue(self) -> None:
        for number in range(len(self._queue.payloads)):
            self._tell("sent", number)

    def _tell(self, event: str, number: int) -> None:
        payload = base64.b64encode(self._queue.payloads[number]).decode()
        self._trace.write({"event": event, "id": f"m{number}", "payload": payload})

    def _see(self, message: Message) -> None:
        self._t_ns += 1
        body = json.loads(message.wire())
        assert isinstance(message, Measurement | Offer)
        self._seen.append(
            {"event": "field", "t_ns": self._t_ns, "topic": message.topic, "message": body}
        )

    def _capture_back(self) -> None:
        """A controller that died before it saved had not published its offer either."""
        del self._seen[-1]


def kill(writer: TraceWriter) -> None:
    """Close without an end mark."""

    def gone(_file: int, _data: bytes) -> int:
        raise OSError

    assert writer.lines is not None
    writer.lines.disk = gone
    writer.close()


def read_lines(path: Path) -> Lines:
    """A trace or capture as JSON, to be changed."""
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def write_lines(path: Path, lines: Lines) -> None:
    """Write it back, as compact as it was."""
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    path.write_text(text)
