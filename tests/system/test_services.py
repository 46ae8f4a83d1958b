"""Both ends of a loop: offers that come too early, two controllers, commands, statuses."""

import threading
from pathlib import Path
from typing import Any

import pytest

from plant_service.service import PlantConfig, add_plant
from protocol.link.effects import Effects, Notice
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Message,
    Offer,
    PlantHello,
    PlantModel,
    PlantStatus,
    SendCommand,
    SendReply,
)
from protocol.scenario import Scenario
from protocol.topics import key_of
from runtime.errors import USAGE
from runtime.host import Host
from runtime.logs import logger
from runtime.pace import Pace
from runtime.perform import Do, perform
from runtime.run_folder import CAPTURE, PLANT_STATUS, PLANT_TRACE
from tests.support.line import line_rules
from tests.support.mail import Mail, mail
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.pair import LinePair, Name
from tests.support.recorded_pair import RecordedPair, read_lines
from tests.support.statuses import read_status
from tests.support.traces import events_of


class Heard(RecordedPair):
    """A loop of which every message is kept, as its reader has it."""

    def __init__(self, *args: Any, **more: Any) -> None:
        self.all: list[Message] = []
        super().__init__(*args, **more)

    def said(self, side: Name, message: Mail) -> None:
        said = message.kind.model_validate_json(message.payload)
        assert said.wire() == message.payload, "the ends do not validate their own"
        self.all.append(said)
        super().said(side, message)


def test_field_messages_look_the_same_in_both_states(tmp_path: Path) -> None:
    loop = RecordedPair(tmp_path, b"one", pace="fast")
    loop.steps(400)
    loop.stop()
    lines = read_lines(tmp_path / CAPTURE)
    seen = {line["message"]["k"]: line["message"] for line in lines if line.get("topic") == "offer"}
    offers: dict[int, set[tuple[str, ...]]] = {1: set(), 2: set()}
    state = 1
    for event in events_of(tmp_path / PLANT_TRACE, "transition"):
        offers[state].add(tuple(seen[event["k"]]))
        state = event["s"]
    fields = ("v", "session", "k", "candidates", "cipher", "predictions")
    assert offers[1] == offers[2] == {(*fields, "copy_number", "nonce", "heard", "block", "tag")}


class Rivals(LinePair):
    """Two controllers, which hear the same; those that are ``away`` hear nothing."""

    def __init__(self) -> None:
        self.away: set[Name] = set()
        self.warnings: list[str] = []
        self.offers: dict[tuple[str, int], set[bytes]] = {}
        rules = line_rules(alpha=4.0, largest_input=1e9)
        super().__init__(rules, 0.1, [b"one"], rivals=[b"two"])

    def performer(self, effects: Effects, do: Do) -> None:
        perform(self._noted(effects), do)

    def _noted(self, effects: Effects) -> Effects:
        for effect in effects:
            if isinstance(effect, Notice) and effect.level == "warning":
                self.warnings.append(effect.text)
            yield effect

    def said(self, side: Name, message: Mail) -> None:
        if message.kind is Offer:
            offer = Offer.model_validate_json(message.payload)
            self.offers.setdefault((offer.session, offer.k), set()).add(message.payload)
        super().said(side, message)

    def hear(self, side: Name, message: Mail) -> None:
        names: tuple[Name, ...] = ("plant",) if side == "plant" else ("controller", "rival")
        for name in names:
            if name not in self.away:
                super().hear(name, message)


def test_two_controllers_on_one_loop_take_turns() -> None:
    """One of them has the session; the other one comes in when it falls silent."""
    loop = Rivals()
    loop.run(lambda: bool(loop.received))
    ids = {name: loop.ends[name].endpoint.instance for name in ("controller", "rival")}
    mine = loop.plant.state.session.controller
    first: Name = "controller" if mine == ids["controller"] else "rival"
    k = loop.plant.state.record.link.k
    loop.run(lambda: loop.plant.state.record.link.k > k + 200)
    assert loop.plant.state.session.controller == mine
    assert loop.received == [b"one" if first == "controller" else b"two"]
    loop.away.add(first)
    loop.run(lambda: len(loop.received) == 2)
    assert set(loop.received) == {b"one", b"two"}
    assert all(len(answers) == 1 for answers in loop.offers.values())
    for said in ("two controllers on one loop", "and not with this one"):
        assert any(said in text and all(i in text for i in ids.values()) for text in loop.warnings)


def test_a_plant_that_meets_another_model_alone_ends_with_2(
    sustained: Scenario, tmp_path: Path
) -> None:
    hub = MemoryHub()
    stranger = MemoryBus(hub)
    answer = ControllerHello(
        instance="d" * 16, incarnation=1, fingerprint="e" * 64, verdict="greeting", session=None
    )
    put = stranger.publisher(key_of(ControllerHello, "loop")).put
    stranger.subscribe(key_of(PlantHello, "loop"), lambda *_hello: put(answer.wire()))
    config = PlantConfig(sustained, tmp_path, "loop", Pace("fast"), seed=1)
    host = Host(MemoryBus(hub), MemoryBus(hub), threading.Event())
    add_plant(host, config, logger("plant"))
    assert host.run() == USAGE
    assert read_status(tmp_path / PLANT_STATUS, PlantStatus).phase == "refused"


def test_an_identifier_belongs_to_one_message(tmp_path: Path) -> None:
    loop = Heard(tmp_path, b"one")
    for name, payload in (("a", b"text"), ("a", b"text"), ("a", b"other"), ("initial", b"mine")):
        loop.hear("controller", mail(SendCommand(id=name, payload=payload)))
    loop.until_received(2)
    loop.steps(10)
    answered = [said for said in loop.all if isinstance(said, SendReply)]
    assert [r.accepted for r in answered] == [True, True, False, False]
    assert "already queued" in answered[1].detail
    assert "'a'" in answered[2].detail
    assert "'initial'" in answered[3].detail
    assert loop.received == [b"one", b"text"]


@pytest.mark.slow
def test_what_both_ends_say_is_what_a_reader_takes_and_nothing_is_missing(tmp_path: Path) -> None:
    """Every second status will do, from any moment on."""
    loop = Heard(tmp_path, b"one", pace="x20")
    loop.steps(700)
    kinds = [type(said) for said in loop.all]
    models = [said for said in loop.all if isinstance(said, PlantModel)]
    statuses = [said for said in loop.all if isinstance(said, PlantStatus)]
    assert len(set(map(Message.wire, models))) == 1
    assert kinds.index(PlantModel) < kinds.index(PlantStatus)
    assert 1 < len(models) <= 1 + len(statuses) / 20
    assert kinds.count(ControllerStatus) > 10
    counted = [e["k"] for e in events_of(tmp_path / PLANT_TRACE, "transition")]
    tails = [{row.k for row in s.secrets.tail} for s in statuses]
    counts = [s.step.transitions for s in statuses]
    sizes = [len(tail) for tail, s in zip(tails, statuses, strict=True) if s.step.k > 100]
    assert max(sizes) == 64
    assert sorted(sizes)[len(sizes) // 2] < 40
    for heard in (slice(None), slice(None, None, 2), slice(1, None, 2)):
        assert set().union(*tails[heard]) >= set(counted[: counts[heard][-1]])
    late = slice(len(statuses) // 2, len(statuses) // 2 + 20)
    whole = zip(tails[late], counts[late], strict=True)
    assert any(tail >= set(counted[n - 64 : n]) for tail, n in whole)
