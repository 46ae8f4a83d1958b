"""Transcripts of both ends over a link that a script lets fail: to be read, and reviewed as text.

Each file in ``tests/transcripts`` is a script: lines that begin with ``>`` are carried out, and
what happened is written below each. ``WYNER_REWRITE=1`` writes the files anew; look at the
difference before committing it.

The plant is a line, x+ = x + u + d, with D_c = [-1, 1], alpha = 3 and the candidates 0 and 3: a
disturbance towards the other candidate makes a key, one away from it does not.
"""

import os
from pathlib import Path

import pytest

from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.session import CountedTransition
from protocol.link.step import IDLE, Answered, Step
from protocol.messages import ControllerHello, Measurement, Offer
from tests.support.controller_in_hand import ControllerInHand, Done
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import PlantInHand
from tests.support.records import plant_record
from tests.support.small_run import Queue

FOLDER = Path(__file__).parent / "transcripts"
SCRIPTS = sorted(FOLDER.glob("*.txt"))

RULES = line_rules(alpha=3.0, largest_input=3.0, fingerprint="1" * 64)
CANDIDATES = ((0.0,), (3.0,))


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
    """Both ends, their journals (the records last saved) and what is on its way between them."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.queue = Queue()
        self.draws = Draws()
        self.instances = 0
        self.sessions = 1
        self.saved_sender: tuple[ControllerRecord | None, Step] = (None, IDLE)
        self.sender = self.new_sender(None)
        first = plant_record(session=self.session_id(), k=0, x=(0.0,), u=(0.0,))
        self.saved_receiver: tuple[PlantRecord, Step] = (first, IDLE)
        self.receiver = self.new_receiver(first)
        self.measurement: Measurement | None = None
        self.measured: list[Measurement] = []
        self.offer: Offer | None = None

    def say(self, who: str, text: str) -> None:
        self.lines.append(f"{who:11} {text}")

    def session_id(self) -> str:
        return f"{self.sessions:016x}"

    def instance(self) -> str:
        self.instances += 1
        return f"{self.instances:016x}"

    def new_sender(self, record: ControllerRecord | None, step: Step = IDLE) -> ControllerInHand:
        return ControllerInHand(
            RULES,
            propose,
            self.instance(),
            record,
            *(step if isinstance(step, Answered) else (None, None)),
            messages=self.queue,
            fresh=self.draws,
        )

    def new_receiver(self, record: PlantRecord, step: Step = IDLE) -> PlantInHand:
        return PlantInHand(
            RULES,
            self.instance(),
            record,
            step=step,
        )

    # --- commands ---------------------------------------------------------------------------------

    def queue_message(self, text: str) -> None:
        self.queue.payloads.append(text.encode())
        self.say("controller", f"queues {text!r}")

    def meet(self) -> None:
        """The controller greets, the plant asks, until a session is accepted."""
        said: ControllerHello | None = self.sender.greeting()
        self.say("controller", f"greets, and knows {self.by_name(self.sender.record.session.id)}")
        for _ in range(6):
            if said is not None and self.heard(said) == "accepted":
                return
            hello = self.receiver.hello()
            whom = "anyone" if hello.controller is None else "this controller"
            if hello.controller not in (None, self.sender.instance):
                whom = "another controller"
            self.say(
                "plant",
                f"hello to {whom}, {self.by_name(hello.session)}, {hello.transitions} counted",
            )
            effects = self.sender.heard_plant(hello)
            self.carry_out(effects)
            said = effects.reply
            if said is None:
                self.say("plant", "has waited for long")
                self.receiver.look_around()
        raise AssertionError("the two ends did not meet")

    def heard(self, said: ControllerHello) -> str:
        """The plant hears a hello; says what became of it."""
        self.sessions += 1
        outcome = self.receiver.heard_controller(said, self.session_id())
        if outcome in ("greet", "ended"):
            self.saved_receiver = (self.receiver.record, IDLE)
        if outcome == "ended":
            self.say("plant", f"begins session {self.sessions}")
        else:
            self.sessions -= 1
        return outcome

    def by_name(self, session: str | None) -> str:
        return "no session" if session is None else f"session {int(session, 16)}"

    def measure(self) -> None:
        self.measurement = self.receiver.measurement()
        m = self.measurement
        self.measured.append(m)
        after = f", offer {m.applied_k} led to {m.x_after[0]:g}" if m.x_after else ""
        self.say("plant", f"measures k={m.k} x={m.x[0]:g}{after}")

    def answer(self, how: str) -> None:
        """The controller hears the last measurement; ``how`` says when it dies, if it does."""
        assert self.measurement is not None
        effects = self.sender.measured(self.measurement)
        if how == "and dies before saving":
            self.say("controller", "decides, and dies before it has saved")
            return
        if effects.append:
            assert effects.offer is not None
            self.saved_sender = (
                self.sender.record,
                Answered(self.measurement, effects.offer),
            )
        if how == "and dies before sending":
            self.say("controller", "has saved, and dies before it has sent")
            return
        self.carry_out(effects)

    def carry_out(self, effects: Done) -> None:
        finished = self.sender.finish_step() if effects.append else effects
        if effects.offer is not None:
            record = self.sender.record
            inside = (
                "random"
                if record.link.s == 1
                else f"m[{record.link.p}]={record.frame.message_symbol}"
            )
            self.offer = effects.offer
            self.say(
                "controller", f"offers k={effects.offer.k} cipher={effects.offer.cipher} ({inside})"
            )
        self.finished(finished)
        if effects.refusal:
            self.say("controller", effects.refusal)
        if effects.reply is not None and effects.reply.verdict == "greeting":
            self.say("controller", "greets: which session is this?")
        elif effects.reply is not None:
            self.say("controller", f"says {effects.reply.verdict}")

    def finished(self, effects: Done) -> None:
        if effects.transition is not None:
            self.tell("controller", effects.transition)
        if effects.save:
            self.saved_sender = (self.sender.record, IDLE)
        if effects.delivered is not None:
            self.say("controller", f"message {effects.delivered} is delivered")

    def apply(self, coin: int, d: float, how: str) -> None:
        """The plant takes the last offer; ``how`` says when it dies, if it does."""
        assert self.offer is not None
        what = self.receiver.check(self.offer)
        if what != "current":
            self.say("plant", f"ignores offer {self.offer.k}: {what}")
            return
        x_next = (self.receiver.record.link.x[0] + CANDIDATES[coin][0] + d,)
        if how == "and dies before saving":
            self.say("plant", f"applies candidate {coin}, and dies before it has saved")
            return
        if how == "and dies before counting":
            record = self.receiver.record
            self.saved_receiver = (record, self.receiver.dies_over(self.offer, coin, x_next).step)
            self.say(
                "plant", f"applies candidate {coin}, has saved, and dies before it has counted"
            )
            return
        before = self.receiver.record
        transition = self.receiver.applied(self.offer, coin, x_next)
        assert self.receiver.step is not None
        self.saved_receiver = (before, self.receiver.step.step)
        self.tell("plant", transition, f"b_r={coin}, ")

    def miss(self, d: float) -> None:
        record = self.receiver.record
        self.receiver.missed(record.applied.u, (record.link.x[0] + record.applied.u[0] + d,))
        self.saved_receiver = (self.receiver.record, IDLE)
        self.say("plant", f"no offer in time: holds u={record.applied.u[0]:g}")

    def tell(self, who: str, t: CountedTransition, more: str = "") -> None:
        gauges = " ".join(f"{g:g}" for g in t.verdict.gauges)
        if t.role == "message":
            outcome = f"cipher {t.cipher} under key {t.key}: m[{t.p - 1}]={t.message_symbol}"
        elif t.symbol >= 0:
            outcome = f"gauges {gauges}: key {t.symbol}"
        else:
            outcome = f"gauges {gauges}: no key"
        self.say(who, f"counts j={t.j} k={t.k}: {more}{outcome}; s={t.s}")

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
                effects = self.sender.measured(late)
                self.carry_out(effects)
                if effects.offer is None and effects.reply is None:
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
                self.sender = self.new_sender(*self.saved_sender)
                if self.sender.unfinished:
                    self.finished(self.sender.finish_step())
            case ["controller", "forgets"]:
                self.saved_sender = (None, IDLE)
                self.sender = self.new_sender(None)
            case ["plant", "restarts"]:
                self.receiver = self.new_receiver(*self.saved_receiver)
                for event in self.receiver.events:
                    if isinstance(event, CountedTransition):
                        self.tell("plant", event, f"b_r={event.coin}, ")
            case ["plant", "forgets"]:
                self.sessions += 1
                first = plant_record(session=self.session_id(), k=0, x=(0.0,), u=(0.0,))
                self.saved_receiver = (first, IDLE)
                self.receiver = self.new_receiver(first)
            case _:
                raise AssertionError(f"no such command: {command}")


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
