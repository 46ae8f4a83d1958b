"""`mac` and `coding`: who rewrites the bus is refused, or seen; without them never.

Both ends with their files are the services', and so is the attack's process; time is virtual, and
an attack begins in a state of the loop. One run of each kind is live.
"""

import json
import shutil
import threading
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from attacker_service.attacker import Attacker
from attacker_service.relay import Rewriter
from controller_service.command import designed
from controller_service.laws.base import CandidateLaw
from protocol.link.guarded import MARGIN
from protocol.messages import ControllerStatus, Message, PlantStatus
from protocol.scenario import Scenario, attack_of, parse_scenario
from protocol.scenario.reading import ScenarioError
from protocol.secret.tasks import Done, Task
from protocol.topics import key_of
from protocol.vectors import Vector
from runtime import host
from runtime.bus import Bus
from runtime.keys.key_maker import KeyMakerAt, work
from runtime.recording import TraceReader
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from runtime.scenario_file import scenario_of
from tests.campaigns.attacked import run
from tests.support.recorded_loop import RecordedLoop
from tests.support.two_ends import SIDES
from wyner.runs.resolve import Resolved

pytestmark = pytest.mark.slow

OWN = Path(__file__).with_name("own_defences.py")
EDGE = f"{Path(__file__).parents[2] / 'examples/own/edge.py'}:Edge"
SPOILT = Path(__file__).with_name("spoilt.py")

AHEAD = 40
"""Steps for which an end holds keys, when an attack begins: more than are looked at."""

LOOK = 5
"""Steps in a row of which all are guarded, and watched, before an attack begins."""

HELD = 24
"""Keys that each end could give when a live run goes on with them."""

LIMIT_S = 300.0
"""Seconds that a live run has for what takes three."""


class Loose:
    """An attack on the bus that is let loose when the loop is in some state."""

    def __init__(self, attacker: Attacker) -> None:
        self._attacker = attacker
        self.sieve = attacker.sieve
        self.loose = False
        self.onset = -1
        """Step of the first offer that it rewrote."""

    def state(self, k: int, x: Vector, *, applied: bool) -> Vector:
        return self._attacker.state(k, x, applied=applied) if self.onset >= 0 else x

    def candidates(self, k: int, true: Sequence[Vector]) -> tuple[Vector, ...]:
        if not self.loose:
            return tuple(true)
        self.onset = k if self.onset < 0 else self.onset
        return self._attacker.candidates(k, true)


def tables(defence: dict[str, str]) -> str:
    lines = [f"{name} = {json.dumps(value)}" for name, value in defence.items()]
    return "\n".join(["", "[defence]", *lines, ""])


class Loop(RecordedLoop):
    """The loop of scenario `keys`, at its period, under a defence."""

    def __init__(self, folder: Path, defence: dict[str, str]) -> None:
        super().__init__(folder, name="keys", more=tables(defence), pace="realtime")
        self.defence = (
            scenario_of("keys")
            .model_validate(
                scenario_of("keys").model_dump(exclude_unset=True) | {"defence": defence}
            )
            .defence
        )

    @property
    def k(self) -> int:
        return self.plant.record.k

    def steps(self, number: int) -> None:
        until = self.k + number
        self.run(lambda: self.k >= until)

    def serves(self) -> bool:
        """Whether each of the next steps is guarded both ways, and watched, as it should be."""
        ends = (self.ends["controller"], self.ends["plant"])
        hear = [e.files.guarded for e in ends if e.files.guarded is not None]
        guard = self.defence.guard(2, 4)
        hear = hear[: 0 if guard is None else 1 + guard.tags]  # a code guards measurements alone
        before = [one.status() for one in hear]
        watched = 0
        for _ in range(LOOK):
            self.steps(1)
            watched += self.plant.record.keyed
        now = [one.status() for one in hear]
        held = [e.files.guarded.status().ahead for e in ends if e.files.guarded is not None]
        return (
            all(b.unguarded == a.unguarded for b, a in zip(before, now, strict=True))
            and all(b.guarded < a.guarded for b, a in zip(before, now, strict=True))
            and all(ahead >= AHEAD for ahead in held[-len(hear) :] if hear)
            and (not self.defence.keyed or watched == LOOK)
        )

    def until_it_serves(self) -> None:
        while not self.serves():
            assert self.k < 5000, "keys never come"

    def until_keys_are_held(self) -> None:
        stores = [e.key_maker.store for e in self.ends.values() if e.key_maker is not None]
        while min(store.available() for store in stores) < HELD:
            self.steps(LOOK)
            assert self.k < 5000, "keys never come"

    def attacked(self, text: str, steps: int) -> dict[str, Any]:
        """What comes of an attack on the bus, once the defence is at work."""
        self.until_it_serves()
        return self.rewritten(text, steps)

    def rewritten(self, text: str, steps: int) -> dict[str, Any]:
        """What comes of an attack on the bus that begins now."""
        attacker = Attacker(self.scenario, attack_of(text), None)
        loose = Loose(attacker)
        self.relay = Rewriter(loose)
        loose.loose = True
        self.steps(steps)
        assert attacker.failed == ""
        self.stop()
        return told(self.folder, loose.onset)


def told(folder: Path, onset: int = 0) -> dict[str, Any]:
    """Alarms, what was refused at each end, and how far the plant was from what was read."""
    lines = {
        side: list(Resolved(TraceReader(folder / name).lines()))
        for side, name in (("plant", PLANT_TRACE), ("controller", CONTROLLER_TRACE))
    }
    steps = [e for e in lines["plant"] if e["event"] == "transition"]
    read = {e["k"] + 1: e["x_next"] for e in lines["controller"] if e["event"] == "transition"}
    away = [
        max(abs(a - b) for a, b in zip(e["x_next"], read[e["k"] + 1], strict=True))
        for e in steps
        if e["k"] + 1 in read
    ]
    return {
        "alarms": [e["k"] + 1 for e in lines["controller"] if e["event"] == "alarm"],
        "forged": {
            side: [(e["k"], e["message"]) for e in events if e["event"] == "forged"]
            for side, events in lines.items()
        },
        "last": max(e["k"] for e in steps),
        "away": max(away, default=0.0),
        "onset": onset,
        "sessions": len({e["session"] for e in lines["plant"] if e["event"] == "session"}),
        "watched": sum(
            e["event"] == "transition" and e.get("expected", -1) >= 0 for e in lines["controller"]
        ),
        "spoofed": sum(e.get("true_x_next", e["x_next"]) != e["x_next"] for e in steps),
    }


@pytest.fixture(scope="module")
def law() -> CandidateLaw:
    return designed(scenario_of("keys"))


@pytest.fixture(scope="module")
def with_keys(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, str], Loop]:
    """A loop whose ends were killed when they held keys, and have begun anew."""

    @cache
    def killed(messages: str) -> Path:
        folder = tmp_path_factory.mktemp("held")
        loop = Loop(folder, {"messages": messages})
        loop.until_keys_are_held()
        for side in SIDES:
            loop.kill(side)
        return folder

    def begun_anew(folder: Path, messages: str) -> Loop:
        shutil.copytree(killed(messages), folder, dirs_exist_ok=True)
        return Loop(folder, {"messages": messages})

    return begun_anew


def test_without_a_guard_covert_is_never_seen(tmp_path: Path) -> None:
    found = Loop(tmp_path, {"kind": "keyed-coin"}).attacked("covert@1", 60)
    assert not found["alarms"]
    assert found["away"] > 4
    assert found["watched"] >= 60


def test_a_mac_stops_covert_before_the_plant_has_moved(tmp_path: Path) -> None:
    """No rewritten offer is applied, and no session ends over it: every step is missed."""
    found = Loop(tmp_path, {"messages": "mac"}).attacked("covert@1", AHEAD)
    assert found["forged"]["controller"] == []
    assert [k for k, _ in found["forged"]["plant"]] == list(
        range(found["onset"], found["onset"] + AHEAD)
    )
    assert {message for _, message in found["forged"]["plant"]} == {"offer"}
    assert found["sessions"] == 1
    assert found["last"] == found["onset"] - 1
    assert found["away"] == 0


def test_coding_with_a_keyed_coin_shows_covert(tmp_path: Path) -> None:
    loop = Loop(tmp_path, {"kind": "keyed-coin", "messages": "coding"})
    found = loop.attacked("covert@1", AHEAD)
    assert found["alarms"]
    assert found["onset"] < found["alarms"][0] <= found["onset"] + 10


@pytest.mark.parametrize("messages", ["mac", "coding", f"{OWN}:Flip"])
def test_an_honest_run_is_guarded_and_nothing_is_refused(messages: str, tmp_path: Path) -> None:
    loop = Loop(tmp_path, {"kind": "keyed-coin", "messages": messages})
    loop.until_it_serves()
    loop.steps(300)
    guard = loop.ends["controller"].files.guarded
    assert guard is not None
    assert guard.status().guarded > 100
    loop.stop()
    found = told(tmp_path)
    assert not found["alarms"]
    assert found["forged"] == {"plant": [], "controller": []}
    assert found["watched"] > 100


@pytest.mark.parametrize("messages", ["mac", "coding"])
def test_ends_that_begin_anew_are_bare_for_a_while_and_covert_is_seen_after(
    messages: str, with_keys: Callable[[Path, str], Loop], tmp_path: Path
) -> None:
    """No process takes up a former one's keys: until new ones are marked the plant moves unseen."""
    found = with_keys(tmp_path, messages).rewritten("covert@1", 60)
    seen = [*found["alarms"], *[k for told in found["forged"].values() for k, _ in told]]
    assert MARGIN <= min(seen) - found["onset"] <= 2 * MARGIN
    assert found["away"] > 1


def test_covert_over_a_network_that_loses_is_labelled_and_never_seen(tmp_path: Path) -> None:
    """It rewrites what leaves; a message that is lost after it moves nothing, as it reckons."""
    attack = attack_of("covert@50")
    loop = RecordedLoop(tmp_path, name="network", pace="realtime", attack=attack)
    attacker = Attacker(loop.scenario, attack, None)
    loop.relay = Rewriter(attacker)
    loop.run(lambda: loop.plant.record.k >= 200)
    assert attacker.failed == ""
    loop.stop()
    found = told(tmp_path)
    missed = [e for e in TraceReader(tmp_path / PLANT_TRACE).lines() if e["event"] == "missed"]
    assert len(missed) > 5
    assert not found["alarms"]
    assert found["away"] > 4
    assert loop.wrong() == []


# --- live -----------------------------------------------------------------------------------------


class KeysAtOnce:
    """Does what is asked of the process for keys, which would wait for an idle core."""

    def put(self, at: KeyMakerAt, done: Callable[[Done], None], task: Task) -> None:
        key_maker = at.open()
        done(work(key_maker, task))
        key_maker.store.close()

    def leave(self, at: KeyMakerAt) -> None:
        pass

    def close(self) -> None:
        pass


class Live:
    """Lets an attack loose when both ends say that they are guarded; ends the run when it shows."""

    def __init__(self, *, tags: bool) -> None:
        self._tags = tags
        self._status: dict[str, Any] = {}

    def attacker(self, attacker: Attacker) -> Loose:
        self._loose = Loose(attacker)
        return self._loose

    def listen(self, management: Bus, stopping: threading.Event) -> None:
        limit = threading.Timer(LIMIT_S, stopping.set)
        limit.daemon = True
        limit.start()
        self.over = limit.cancel
        self.quiet = True
        """Whether nothing was seen before the attack."""

        def hear(kind: type[Message]) -> Callable[[str, bytes, int], None]:
            def heard(_key: str, payload: bytes, _t_ns: int) -> None:
                self._status[kind.topic] = kind.model_validate_json(payload)
                self._look(stopping)

            return heard

        for kind in (PlantStatus, ControllerStatus):
            management.subscribe(key_of(kind, "loop"), hear(kind))

    def _look(self, stopping: threading.Event) -> None:
        plant = self._status.get(PlantStatus.topic)
        controller = self._status.get(ControllerStatus.topic)
        if plant is None or controller is None:
            return
        if not self._loose.loose:
            self.quiet &= plant.forged == controller.forged == controller.alarms == 0
            ahead = min(plant.guard_ahead, controller.guard_ahead if self._tags else AHEAD)
            heard = controller.guarded and (plant.guarded or not self._tags)
            self._loose.loose = bool(heard) and ahead >= AHEAD
        elif plant.forged or controller.forged or controller.alarms:
            stopping.set()


@pytest.mark.long
@pytest.mark.parametrize(
    ("messages", "attack"),
    [("mac", "covert@1"), ("coding", "covert@1"), (f"{OWN}:Flip", f"{SPOILT}:Deaf@1")],
)
def test_an_attack_on_the_bus_is_seen_live(
    messages: str,
    attack: str,
    law: CandidateLaw,
    with_keys: Callable[[Path, str], Loop],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Guards and attacks of one's own, too; whether a step was guarded just then is chance here.

    The run goes on from a folder whose keys were made in virtual time.
    """
    loop = with_keys(tmp_path, messages)
    loop.stop()
    monkeypatch.setattr(host, "KeyWorker", KeysAtOnce)
    watch = Live(tags=messages == "mac")
    run(loop.scenario, law, None, tmp_path, attack_of(attack), pace="realtime", watch=watch)
    watch.over()
    assert watch.quiet
    found = told(tmp_path)
    assert found["alarms"] or found["forged"]["plant"] or found["forged"]["controller"]


def own_test(kind: str) -> Scenario:
    tables = scenario_of("packed").model_dump(exclude_unset=True)
    return Scenario.model_validate(tables | {"defence": {"kind": kind}})


@pytest.mark.parametrize(
    ("attack", "seen"),
    [(None, False), ("ghost@30", True), (f"{SPOILT}:Frozen@30", None), ("bias@30", True)],
)
def test_a_test_of_ones_own_runs_live_beside_an_attack_of_ones_own(
    attack: str | None, seen: bool | None, law: CandidateLaw, tmp_path: Path
) -> None:
    """The toy alarms near the edge of D_c, where a ghost that pushes is, and the honest are not."""
    made = None if attack is None else attack_of(attack)
    run(own_test(EDGE), law, 60, tmp_path, made)
    found = told(tmp_path)
    alarms = found["alarms"]
    assert (found["spoofed"] > 0) == (attack is not None)
    assert seen is None or bool(alarms) == seen
    assert all(k >= 30 for k in alarms)


# --- what cannot be -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("defence", "line"),
    [
        ({"kind": "gost"}, "defence.kind: got 'gost', expected residual"),
        ({"kind": "nowhere.py:X"}, "defence.kind: nowhere.py: no such file"),
        ({"kind": "mac"}, "defence.kind: got 'mac', expected residual, keyed-coin or a test"),
        ({"kind": f"{OWN}:Keyed"}, "defence.kind: got "),
        ({"messages": "residual"}, "defence.messages: got 'residual', expected clear"),
        ({"messages": f"{OWN}:Nothing"}, "defence.messages: got "),
        ({"messages": f"{OWN}:Greedy"}, "defence.messages: "),
        ({"messages": f"{OWN}:Flop"}, "defence.messages: "),
        ({"messages": "static-coding"}, "defence.messages: static-coding: expected one with"),
    ],
)
def test_a_defence_that_cannot_be_is_one_line(defence: dict[str, str], line: str) -> None:
    tables = scenario_of("keys").model_dump(exclude_unset=True)
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(tables | {"defence": defence}, "x")
    assert len(caught.value.problems) == 1
    assert caught.value.problems[0].removeprefix("x: ").startswith(line), caught.value.problems


@pytest.mark.parametrize("defence", [{"kind": "keyed-coin"}, {"messages": "mac"}])
@pytest.mark.parametrize("keys", [None, {"eps_E": 0.0}])
def test_keys_that_cannot_be_made_are_one_line(
    defence: dict[str, str], keys: dict[str, float] | None
) -> None:
    tables = scenario_of("packed").model_dump(exclude_unset=True) | {"defence": defence}
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(tables if keys is None else tables | {"keys": keys}, "x")
    assert len(caught.value.problems) == 1
    assert f"{next(iter(defence.values()))} takes distilled keys" in caught.value.problems[0]


def test_coding_takes_no_more_key_than_there_is() -> None:
    tables = scenario_of("packed-quadruple-tank").model_dump(exclude_unset=True)
    with pytest.raises(ScenarioError, match="coding takes 10 words"):
        parse_scenario(tables | {"keys": {"eps_E": 0.3}, "defence": {"messages": "coding"}}, "x")
