"""Transcripts of both ends over a link that a script lets fail: to be read, and reviewed as text.

Each file in ``tests/transcripts`` is a script: lines that begin with ``>`` are carried out, and
what happened is written below each. ``WYNER_REWRITE=1`` writes the files anew; look at the
difference before committing it.

The plant is a line, x+ = x + u + d, with D_c = [-1, 1], alpha = 3 and the candidates 0 and 3: a
disturbance towards the other candidate makes a key, one away from it does not.
"""

import os
from collections import deque
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol.link.endpoint import Actions, Endpoint, Outgoing
from protocol.link.events import Applied, Delivered, Event, Missed
from protocol.link.pacing import Pacing
from protocol.link.perform import CrashPoint, Killed, Mortal, perform
from protocol.link.session import SILENCE_S, Transition
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello, SendCommand
from protocol.runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal
from tests.support.line_ends import ToldPorts, line_controller, line_plant
from tests.support.line_plant import line_rules

FOLDER = Path(__file__).parent / "transcripts"
SCRIPTS = sorted(FOLDER.glob("*.txt"))

RULES = line_rules(alpha=3.0, largest_input=3.0, fingerprint="1" * 64)
CANDIDATES = ((0.0,), (3.0,))

STEP_S = 10.0
REPEATS = 100
"""A step is longer than the silence after which a plant looks around, and a repeat is shorter: so a
script can have either."""

RESTART_S = 4.0
"""How long a plant is away that dies: long enough not to be taken for a second one."""


def propose(_x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    return CANDIDATES


class Draws:
    """Random symbols whose every draw is another one, so that drawing twice would show."""

    def __init__(self) -> None:
        self._drawn = 0

    def symbol(self, _transition: int, _size: int) -> int:
        self._drawn += 1
        return "0110100110010110"[self._drawn % 16] == "1"


class Link:
    """Both endpoints, their journals, and what they said last; the script is the network."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.now = 0.0
        self.draws = Draws()
        self.instances = 0
        self.sessions = 0
        self.measured: list[Measurement] = []
        self.offer: Outgoing | None = None
        self.words: deque[Outgoing] = deque()  # on ops, not heard yet
        self.said: list[Outgoing] = []  # within the act under way
        self.told: list[str] = []
        self.traced: list[Event] = []
        self.queue = MemoryControllerJournal()
        self.journal = MemoryPlantJournal()
        ports = (self.said.append, self.traced.append, lambda n: self.told.append(n.text))
        self.sender_ports = Mortal(ToldPorts(self.queue, *ports))
        self.plant_ports = Mortal(ToldPorts(self.journal, *ports))
        self.start_controller()
        self.start_plant()

    def say(self, who: str, text: str) -> None:
        self.lines.append(f"{who:11} {text}")

    def new_session(self) -> str:
        return f"{self.sessions + 1:016x}"

    def instance(self) -> str:
        self.instances += 1
        return f"{self.instances:016x}"

    def start_controller(self) -> None:
        self.words.clear()
        self.sender = line_controller(RULES, propose, self.queue, self.draws, self.instance())
        self.act("controller", lambda: self.sender.start(self.now))

    def start_plant(self) -> None:
        self.now += RESTART_S
        pacing = Pacing(STEP_S, REPEATS, self.now)
        fresh = self.journal.load() is None
        self.plant, self.line = line_plant(
            RULES, self.journal, self.new_session, self.instance(), self.now, pacing
        )
        self.sessions += fresh
        self.act("plant", lambda: self.plant.start(self.now))

    # --- acts -------------------------------------------------------------------------------------

    def act(self, who: str, do: Callable[[], Actions], dies: CrashPoint | None = None) -> bool:
        """Have one end do something, and say what came of it; False when it died."""
        endpoint: Endpoint = self.sender if who == "controller" else self.plant
        ports = self.sender_ports if who == "controller" else self.plant_ports
        ports.doom(before=dies)
        try:
            perform(do(), endpoint, ports)
        except Killed:
            for list_ in (self.said, self.traced, self.told):
                list_.clear()
            return False
        self.tell_all(who)
        return True

    def tell_all(self, who: str) -> None:
        said, traced, told = self.said[:], self.traced[:], self.told[:]
        for list_ in (self.said, self.traced, self.told):
            list_.clear()
        for kind, payload in said:
            if kind is Offer:
                self.offer = Outgoing(kind, payload)
                record, offer = self.sender.sender.record, Offer.model_validate_json(payload)
                inside = "random" if record.s == 1 else f"m[{record.p}]={record.message_symbol}"
                self.say("controller", f"offers k={offer.k} cipher={offer.cipher} ({inside})")
            elif kind is Measurement:
                self.measured.append(Measurement.model_validate_json(payload))
            else:
                self.words.append(Outgoing(kind, payload))
        for event in traced:
            self.tell(event)
        for text in told:
            if who == "controller" and "taken up" not in text and "delivered" not in text:
                self.say("controller", text)

    def tell(self, event: Event) -> None:
        match event:
            case Transition() as t:
                self.say("controller", counts(t))
            case Applied(t, coin):
                self.say("plant", counts(t, f"b_r={coin}, "))
            case Missed(_, _, _, u):
                self.say("plant", f"no offer in time: holds u={u[0]:g}")
            case Delivered(number):
                self.say("controller", f"message {number} is delivered")

    # --- commands ---------------------------------------------------------------------------------

    def queue_message(self, text: str) -> None:
        command = SendCommand(id=text, payload=text.encode())
        self.act("controller", lambda: self.sender.receive(SendCommand, command.wire(), self.now))
        self.say("controller", f"queues {text!r}")

    def meet(self) -> None:
        """The controller greets, the plant asks, until a session is accepted."""
        self.words.clear()
        greeting = self.sender.sender.greeting()
        self.say("controller", f"greets, and knows {spoken(greeting.session)}")
        said: Outgoing | None = Outgoing(ControllerHello, greeting.wire())
        for _ in range(6):
            if said is not None:
                self.heard(said)
                if self.plant.plant.receiver.accepted and not self.words:
                    return
            hello = PlantHello.model_validate_json(self.words.popleft().payload)
            whom = "anyone" if hello.controller is None else "this controller"
            if hello.controller not in (None, self.sender.sender.instance):
                whom = "another controller"
            self.say(
                "plant",
                f"hello to {whom}, {spoken(hello.session)}, {hello.transitions} counted",
            )
            self.act(
                "controller",
                lambda: self.sender.receive(PlantHello, hello.wire(), self.now),  # noqa: B023
            )
            said = self.words.popleft() if self.words else None
            if said is not None:
                answer = ControllerHello.model_validate_json(said.payload)
                self.say("controller", f"says {answer.verdict}")
            else:
                self.say("plant", "has waited for long")
                self.now += SILENCE_S
                self.act("plant", lambda: self.plant.wake(self.now))
        raise AssertionError("the two ends did not meet")

    def heard(self, said: Outgoing) -> None:
        """The plant hears a hello."""
        before = self.plant.plant.receiver.record.session
        self.act("plant", lambda: self.plant.receive(*said, self.now))
        if self.plant.plant.receiver.record.session != before:
            self.sessions += 1
            self.say("plant", f"begins session {self.sessions}")

    def measure(self) -> None:
        """The plant's newest measurement, or the same once more.

        One that no controller has accepted keeps it to itself, so the script says it for it.
        """
        self.words.clear()
        known = len(self.measured)
        if not self.plant.plant.receiver.accepted:
            self.measured.append(self.plant.plant.receiver.measurement())
        while len(self.measured) == known:
            self.now = max(self.now, self.plant.wake_at())
            self.act("plant", lambda: self.plant.wake(self.now))
        m = self.measured[-1]
        after = f", offer {m.applied_k} led to {m.x_after[0]:g}" if m.x_after else ""
        self.say("plant", f"measures k={m.k} x={m.x[0]:g}{after}")

    def answer(self, how: str) -> None:
        """The controller hears the last measurement; ``how`` says when it dies, if it does."""
        deaths: dict[str, tuple[CrashPoint | None, str]] = {
            "": (None, ""),
            "and dies before saving": ("writing", "decides, and dies before it has saved"),
            "and dies before sending": ("publishing", "has saved, and dies before it has sent"),
        }
        dies, text = deaths[how]
        self.hears(self.measured[-1], dies)
        if text:
            self.say("controller", text)

    def hears(self, measurement: Measurement, dies: CrashPoint | None = None) -> None:
        self.words.clear()
        self.act(
            "controller",
            lambda: self.sender.receive(Measurement, measurement.wire(), self.now),
            dies,
        )
        if self.words:
            self.words.clear()
            self.say("controller", "greets: which session is this?")

    def apply(self, coin: int, d: float, how: str) -> None:
        """The plant takes the last offer; ``how`` says when it dies, if it does."""
        assert self.offer is not None
        message = self.offer
        self.line.coin, self.line.d = coin, d
        offer = Offer.model_validate_json(message.payload)
        what = self.plant.plant.receiver.check(offer)
        if what != "current":
            self.say("plant", f"ignores offer {offer.k}: {what}")
        deaths: dict[str, tuple[CrashPoint | None, str]] = {
            "": (None, ""),
            "and dies before saving": ("writing", "and dies before it has saved"),
            "and dies before counting": (
                "tracing",
                "has saved, and dies before it has counted",
            ),
        }
        dies, text = deaths[how]
        self.act("plant", lambda: self.plant.receive(*message, self.now), dies)
        if text:
            self.say("plant", f"applies candidate {coin}, {text}")

    def miss(self, d: float) -> None:
        """The time for an offer runs out."""
        self.line.d = d
        k = self.plant.plant.receiver.record.k
        while self.plant.plant.receiver.record.k == k:
            self.now = max(self.now, self.plant.wake_at())
            self.act("plant", lambda: self.plant.wake(self.now))

    def run(self, command: str) -> None:
        """Carry out one command of a script."""
        words = command.split()
        values = dict(word.split("=", 1) for word in words if "=" in word)
        match words:
            case ["queue", text]:
                self.queue_message(text)
            case ["meet"]:
                self.meet()
            case ["measure"]:
                self.measure()
            case ["answer", "late", *_]:
                late = next(m for m in self.measured if m.k == int(values["k"]))
                before = len(self.lines)
                self.hears(late)
                if len(self.lines) == before:
                    self.say("controller", f"ignores measurement {late.k}")
            case ["answer", *how]:
                self.answer(" ".join(how))
            case ["apply", _, _, *how]:
                self.apply(int(values["coin"]), float(values["d"]), " ".join(how))
            case ["step", *_]:
                self.measure()
                self.answer("")
                self.apply(int(values["coin"]), float(values["d"]), "")
            case ["miss", *_]:
                self.miss(float(values["d"]))
            case ["controller", "restarts"]:
                self.start_controller()
            case ["controller", "forgets"]:
                self.queue.forget()
                self.start_controller()
            case ["plant", "restarts"]:
                self.start_plant()
            case ["plant", "forgets"]:
                self.journal.forget()
                self.start_plant()
            case _:
                raise AssertionError(f"no such command: {command}")


def spoken(session: str | None) -> str:
    return "no session" if session is None else f"session {int(session, 16)}"


def counts(t: Transition, more: str = "") -> str:
    gauges = " ".join(f"{g:g}" for g in t.verdict.gauges)
    if t.role == "message":
        outcome = f"cipher {t.cipher} under key {t.key}: m[{t.p - 1}]={t.message_symbol}"
    elif t.symbol >= 0:
        outcome = f"gauges {gauges}: key {t.symbol}"
    else:
        outcome = f"gauges {gauges}: no key"
    return f"counts j={t.j} k={t.k}: {more}{outcome}; s={t.s}"


def carried_out(script: str) -> str:
    """The script with what happens below each command; comments and blank lines stay."""
    link = Link()
    out = []
    for line in script.splitlines():
        if line.startswith("> "):
            out.append(line)
            link.lines = []
            link.run(line.removeprefix("> "))
            out += [f"  {said}" for said in link.lines]
        elif not line.startswith("  "):
            out.append(line)
    return "\n".join(out) + "\n"


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_transcript(path: Path) -> None:
    written = path.read_text(encoding="utf-8")
    happened = carried_out(written)
    if os.environ.get("WYNER_REWRITE"):
        path.write_text(happened, encoding="utf-8")
    assert happened == written, "WYNER_REWRITE=1 writes it anew"


def test_there_are_transcripts() -> None:
    assert {path.stem for path in SCRIPTS} >= {
        "lost-and-repeated",
        "restarts",
        "a-lost-journal",
        "overtaken",
    }
