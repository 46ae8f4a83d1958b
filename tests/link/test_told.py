"""All that the services' ends do in some stories: their effects, one by one, as they were.

What stands out of each story, notices, events and the last statuses, is a text beside this file;
the digest below it is of every line of the traces, message, notice and save, with numbers to six
digits. A change of what the ends say, or when, is a change of these texts: ``WYNER_REWRITE=1``
rewrites them, to be reviewed. All that went into a digest is left as ``whole.txt`` where one fails.
"""

import hashlib
import json
import os
import random
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from protocol.link.effects import Effect, Effects, Notice, Publish, Save, Tell
from protocol.link.events import lines
from protocol.link.session import CountedTransition
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantStatus,
    SendCommand,
    StopKeys,
)
from protocol.messages.base import Part
from protocol.secret.blocks import ExtractionFailed
from runtime import journal as journals
from runtime.perform import Do, perform
from tests.support.mail import Mail, mail
from tests.support.pair import SIDES, Name
from tests.support.recorded_pair import RecordedPair
from tests.support.scenarios import text_of

TOLD = Path(__file__).parent / "told"
PASSING = {"v", "t_ns", "text", "detail"}
"""Of a message or notice what is no deed: hours, and wording."""

BULKY = {"tail", "pictured", "latency_counts"}
"""Fields of a status that the digest alone has."""


def plain(value: Any) -> Any:
    """A value as it is told here: numbers to six digits, bytes in hexadecimal."""
    if isinstance(value, float):
        return float(f"{round(value, 9):.6g}") + 0.0
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items() if k not in PASSING}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def fields_of(part: Part, before: str = "") -> Iterator[tuple[str, Any]]:
    """The fields of a status and of its parts that have not their default, without the bulky."""
    for name, field in type(part).model_fields.items():
        value = getattr(part, name)
        if isinstance(value, Part) and name not in BULKY:
            yield from fields_of(value, f"{before}{name}.")
        elif value != field.default and name not in BULKY | PASSING:
            yield f"{before}{name}", value


class Changed:
    """Passes the field bus, and alters what it is told to.

    Attributes
    ----------
    alter : dict of type to callable
        The fields of a message that are others when it arrives.
    """

    def __init__(self) -> None:
        self.alter: dict[type[Message], Callable[[Any], dict[str, Any]]] = {}

    def incoming(self, kind: type[Message], payload: bytes) -> bytes:
        alter = self.alter.get(kind)
        if alter is None:
            return payload
        message = kind.model_validate_json(payload)
        return message.model_copy(update=alter(message)).wire()


class Story(RecordedPair):
    """A loop whose effects are noted."""

    def __init__(self, folder: Path, *payloads: bytes, **more: Any) -> None:
        self.seen: list[str] = []
        self.whole: list[str] = []
        self.statuses: dict[str, dict[str, Any]] = {}
        super().__init__(folder, *payloads, **more)
        self.relay = self.between = Changed()  # type: ignore[assignment]

    def performer(self, effects: Effects, do: Do) -> None:
        (side,) = [name for name, end in self.ends.items() if end.shell.do == do]
        perform(self._noted(side, effects), do)

    def _noted(self, side: Name, effects: Iterable[Effect]) -> Iterator[Effect]:
        for effect in effects:
            self._note(side, effect)
            yield effect

    def _note(self, side: Name, effect: Effect) -> None:
        whole: list[Any] = [type(effect).__name__]
        match effect:
            case Notice(level=level, subject=subject):
                self.seen.append(f"{side}: {level} {subject}".rstrip())
                whole += [level, subject]
            case Tell(event):
                told = lines(event)
                whole += told
                if isinstance(event, CountedTransition):
                    told = told[1:]  # the digest alone has the transition itself
                self.seen += [f"{side}: {json.dumps(plain(line))}" for line in told]
            case Publish(message):
                whole += [message.topic, message.model_dump()]
                self._said(side, message)
            case Save(durable=durable, received=received, queued=queued):
                whole += [durable, received, queued is not None]
        self.whole.append(f"{side} {json.dumps(plain(whole), sort_keys=True)}\n")

    def _said(self, side: Name, message: Message) -> None:
        if isinstance(message, PlantHello | ControllerHello):
            verdict = getattr(message, "verdict", "")
            self.seen.append(f"{side}: {message.topic} {verdict}".rstrip())
        if isinstance(message, PlantStatus | ControllerStatus):
            self.statuses[side] = dict(fields_of(message))

    def text(self) -> str:
        """What stands out, and the digest of all, which lies beside the run."""
        again = [*self.seen]
        for side, status in self.statuses.items():
            again += [f"{side}.{name} = {value}" for name, value in plain(status).items()]
        whole = "".join(self.whole)
        self.folder.with_name("whole.txt").write_text(whole)
        return "\n".join([*again, hashlib.sha256(whole.encode()).hexdigest()]) + "\n"


# --- the stories ----------------------------------------------------------------------------------


def all_is_well(folder: Path) -> Story:
    """Two messages arrive, one after the other, and both ends are asked to end."""
    loop = Story(folder, b"a", b"bc", name="packed")
    loop.queue("late", b"")
    loop.until_received(3)
    loop.steps(8)
    loop.queue("late", b"other")
    loop.steps(2)
    loop.stop()
    return loop


def what_goes_wrong(folder: Path) -> Story:
    """Losses, repeats, deaths, journals that are lost and put back, a boot of the machine."""
    loop = Story(folder, b"once", b"again", name="packed", bounds=None)
    loop.steps(24, {3: "repeated", 5: "offer lost", 8: "plant dies", 12: "controller dies"})
    loop.step("journal copied")
    loop.steps(6)
    loop.step("plant forgets")
    loop.steps(12)
    loop.step("controller forgets")
    loop.until_received(1)
    loop.stop()
    return loop


def put_back(folder: Path) -> Story:
    """The plant's journal is an older one, and the two ends do not fit together any more."""
    loop = Story(folder, b"once", name="packed")
    loop.steps(10, {4: "journal copied"})
    loop.steps(12, {0: "journal put back"})
    return loop


def the_power_fails(folder: Path) -> Story:
    """The machine of both ends is started again."""
    loop = Story(folder, b"once", name="packed")
    loop.steps(10)
    for side in SIDES:
        loop.kill(side)
    journals.BOOT_ID.write_text("another\n")
    for side in SIDES:
        loop.start(side)
    loop.steps(12)
    return loop


def a_frame_is_damaged(folder: Path) -> Story:
    """An offer's cipher symbol is another one when it arrives."""
    loop = Story(folder, b"once", name="packed")
    loop.steps(10)
    loop.between.alter[Offer] = lambda m: {"cipher": (m.cipher + 1) % 4}
    loop.steps(2)
    loop.between.alter.clear()
    loop.steps(40)
    return loop


def nothing_explains_a_reading(folder: Path, *, halts: bool = False) -> Story:
    """A reading is shifted on its way: the controller alarms, and stops where it is asked to."""
    more = '\n[defence]\non_alarm = "safe"\n' if halts else ""
    watchdog = ("[link]\n", "[link]\nwatchdog_s = 60.0\n")
    loop = Story(folder, b"once", name="packed", more=more, changes=(watchdog,) * halts)
    loop.steps(5)
    loop.between.alter[Measurement] = lambda m: {"x": (m.x[0] + 5.0, m.x[1])}
    if halts:
        for _ in range(60):
            loop.next()
    else:
        loop.steps(2)
    loop.between.alter.clear()
    for _ in range(60):
        loop.next()
    return loop


def an_alarm_halts(folder: Path) -> Story:
    """The same, where an alarm ends all offers."""
    return nothing_explains_a_reading(folder, halts=True)


def strangers(folder: Path) -> Story:
    """Hellos of other models, partners and former lives; what is late, stale or no message."""
    loop = Story(folder, b"once", name="packed")
    loop.steps(5)
    plant, controller = loop.plant, loop.controller
    session = plant.state.record.session.id
    asks = PlantHello(
        instance="e" * 16,
        session=session,
        controller=None,
        incarnation=1,
        fingerprint=plant.state.rules.fingerprint,
        transitions=0,
        applied_k=-1,
    )
    answers = ControllerHello(
        instance="d" * 16,
        incarnation=1,
        fingerprint=controller.state.rules.fingerprint,
        verdict="greeting",
        session=session,
    )
    other = {"fingerprint": "e" * 64}
    offer = controller.state.record.offer
    assert offer is not None
    for said in (
        asks,
        asks.model_copy(update=other),
        asks.model_copy(update={"session": "5" * 16}),
        asks.model_copy(update={"controller": controller.instance, "session": "5" * 16}),
    ):
        loop.hear("controller", mail(said))
    for message in (
        answers,
        answers.model_copy(update=other),
        answers.model_copy(update={"session": None}),
        answers.model_copy(update={"verdict": "accepted", "answers": plant.instance}),
        offer.model_copy(update={"k": offer.k - 2}),
        offer.model_copy(update={"k": offer.k + 2}),
        offer.model_copy(update={"stream_block": 0, "stream_at": 0}),
        offer.model_copy(update={"candidates": offer.candidates[:1]}),
    ):
        loop.hear("plant", mail(message))
        loop.hear("plant", Mail(Offer, b"{"))
    for _ in range(3):
        loop.hear("controller", Mail(Measurement, b"no message"))
        loop.hear("controller", mail(SendCommand(id="m", payload=b"x")))
        loop.hear("controller", mail(SendCommand(id="m", payload=b"y")))
    loop.steps(5)
    session = plant.state.record.session.id
    old = Measurement(session=session, k=1, x=(0.0, 0.0), applied_k=0, x_after=(0.0, 0.0))
    for _ in range(70):
        loop.now += 0.05
        loop.hear("controller", mail(old))
    loop.steps(5)
    return loop


def hear_of_another_model(loop: Story) -> None:
    """Before anything else each end hears an end of another model."""
    for side in SIDES:
        loop.mail[side].clear()
    asks = PlantHello(
        instance="e" * 16,
        session="5" * 16,
        controller=None,
        incarnation=0,
        fingerprint="e" * 64,
        transitions=0,
        applied_k=-1,
    )
    loop.hear("controller", mail(asks))
    answers = ControllerHello(
        instance="d" * 16, incarnation=1, fingerprint="e" * 64, verdict="greeting", session=None
    )
    loop.hear("plant", mail(answers))


def met_before(folder: Path) -> Story:
    """Another model is passed over by ends that have met one of their own, in a life before."""
    loop = Story(folder, b"once", name="packed")
    loop.steps(5)
    for side in SIDES:
        loop.die(side)
    hear_of_another_model(loop)
    loop.steps(5)
    return loop


def never_met(folder: Path) -> Story:
    """It is the end of those that have met nobody yet."""
    loop = Story(folder, b"once", name="packed")
    hear_of_another_model(loop)
    for side in SIDES:
        end = loop.ends[side].endpoint
        loop.seen.append(f"{side} ends with {end.code}, due {end.wake_at():g}")
        loop.do(side, end.wake)
        loop.seen.append(f"{side} ends with {end.code}")
    loop.stop()
    return loop


def keys_are_made(folder: Path) -> Story:
    """Blocks are confirmed and spent, more links come and go, and the claim is refuted."""
    more = '\n[defence]\ncoin = "keys"\n'
    loop = Story(folder, b"a", name="keys", more=more)
    loop.steps(90, {60: "plant dies", 70: "controller dies"})
    for count in (3, 1):
        for side in SIDES:
            end = loop.ends[side].endpoint
            loop.do(side, lambda _now, e=end, c=count: e.appear(c))  # type: ignore[misc]
            loop.do(side, lambda _now, e=end, c=count: e.appear(c))  # type: ignore[misc]
        loop.steps(4)
    loop.hear("controller", mail(StopKeys(reason="Eve missed nothing")))
    loop.hear("controller", mail(StopKeys(reason="once more")))
    loop.steps(6)
    loop.restart("controller", "lost")
    loop.steps(6)
    return loop


def keys_differ(folder: Path) -> Story:
    """A tag is another one when it arrives, and later no block can be extracted."""
    loop = Story(folder, name="keys")
    loop.between.alter[Offer] = lambda m: {"tag": m.tag[::-1]} if m.block >= 0 else {}
    loop.steps(90)
    loop.between.alter.clear()
    for side in SIDES:
        end = loop.ends[side].endpoint
        loop.do(side, lambda _now, e=end: e.extracted(ExtractionFailed("no memory")))  # type: ignore[misc]
    loop.steps(8)
    return loop


def a_device_acts(folder: Path) -> Story:
    """A plant that nobody can put back: a death loses its step."""
    text = text_of("packed-double-integrator")
    _, plant, rest = text.partition("[plant]\n")
    plant, defender, rest = rest.partition("[defender.disturbance]\n")
    matrices = "".join(line for line in plant.splitlines(True) if line[:3] in ("A =", "B ="))
    own = 'kind = "python"\nobject = "tests.adapters.plants:PythonLine"\nperiod_s = 1.0\n'
    scales = "state_scale = [2.0, 2.0], input_scale = [2.0]"
    own += f"operating_point = {{ state = [0.0, 0.0], input = [0.0], {scales} }}\n"
    own += '[plant.disturbance]\nenters = "none"\n'
    changes = ((plant, own), (defender, f"[defender]\n{matrices}\n{defender}"))
    loop = Story(folder, b"a", name="packed-double-integrator", changes=changes)
    loop.steps(20, {4: "offer lost", 8: "plant dies", 12: "controller dies", 16: "repeated"})
    loop.crash_at("plant", "acting")
    loop.steps(8)
    loop.stop()
    return loop


def the_plant_is_over(folder: Path) -> Story:
    """It has made its steps, and ends when its last report is answered, or after a while."""
    loop = Story(folder, name="packed", last=6)
    for lost in (False, True):
        while loop.plant.code is None:
            if lost:
                loop.mail["controller"].clear()
            loop.next()
        loop.seen.append(f"ends with {loop.plant.code} at {loop.now:.6g}")
        loop.die("plant")
    return loop


def of(name: str) -> Callable[[Path], Story]:
    """The same faults in another shipped loop."""

    def told(folder: Path) -> Story:
        loop = Story(folder, b"a", name=name)
        loop.steps(70, {20: "plant dies", 30: "controller dies", 40: "repeated", 60: "offer lost"})
        loop.stop()
        return loop

    told.__name__ = name
    return told


STORIES: list[Callable[[Path], Story]] = [
    all_is_well,
    what_goes_wrong,
    put_back,
    the_power_fails,
    a_frame_is_damaged,
    nothing_explains_a_reading,
    an_alarm_halts,
    strangers,
    never_met,
    met_before,
    keys_are_made,
    keys_differ,
    a_device_acts,
    the_plant_is_over,
    *map(of, ("sealed", "watched", "encoder", "network", "motor", "paper", "pendulum", "st-mpc")),
]


@pytest.mark.parametrize("story", STORIES)
def test_a_story_is_told_as_it_was(
    story: Callable[[Path], Story], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boot = tmp_path / "boot"
    boot.write_text("one\n")
    monkeypatch.setattr(journals, "BOOT_ID", boot)
    draws: dict[int, random.Random] = {}

    def drawn(size: int) -> bytes:
        """Ids and nonces each have numbers of their own."""
        return draws.setdefault(size, random.Random(size)).randbytes(size)

    for where in ("os.urandom", "random._urandom"):
        monkeypatch.setattr(where, drawn)
    text = story(tmp_path / "run").text()
    path = TOLD / f"{story.__name__}.txt"
    if os.environ.get("WYNER_REWRITE"):
        path.write_text(text)
    assert text == path.read_text(), "review, then rewrite with WYNER_REWRITE=1"
