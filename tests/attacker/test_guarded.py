"""`mac` and `coding` live: who rewrites the bus is refused, or seen."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from controller_service.command import designed
from controller_service.laws.base import CandidateLaw
from protocol.scenario import Attack, Scenario, attack_of, parse_scenario
from protocol.scenario.reading import ScenarioError
from runtime.keys.store import KeyStore
from runtime.recording import TraceReader
from runtime.run_folder import (
    CONTROLLER_KEYS,
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
    PLANT_KEYS,
    PLANT_STATUS,
    PLANT_TRACE,
)
from runtime.scenario_file import scenario_of
from tests.campaigns.attacked import run
from wyner.runs.resolve import Resolved

pytestmark = pytest.mark.slow

FILLS = 1500
"""Steps of an honest run until its keys serve; beside other work it takes several."""

HELD = 48
"""Keys that a filled run has left at each end, to guard the run that goes on from it."""

ONSET = 160
"""Steps from there on to an attack: its process has keys of its own by then."""


class Filled:
    """A run that has made keys, under a defence; copies of it go on."""

    def __init__(self, folder: Path, law: CandidateLaw, defence: dict[str, str]) -> None:
        tables = scenario_of("keys").model_dump(exclude_unset=True)
        self.scenario = Scenario.model_validate(tables | {"defence": defence})
        self._law, self._folder = law, folder / "filled"
        self._folder.mkdir()
        self.steps = 0
        while not self._serve() and self.steps < 10 * FILLS:
            self.steps += FILLS
            guarded = self.scenario.defence.guards
            run(self.scenario, law, self.steps, self._folder, pace="x10" if guarded else "fast")
        self.onset = self.steps + ONSET

    def _serve(self) -> bool:
        """Whether keys served in the last of the runs, at each end that takes some."""
        if not self.steps:
            return False
        told = [
            json.loads((self._folder / name).read_bytes())
            for name in (CONTROLLER_STATUS, PLANT_STATUS)
        ]
        defence = self.scenario.defence
        guard = defence.guard(2, 4)
        heard = guard is None or told[0]["guarded"]
        both = guard is None or not guard.tags or told[1]["guarded"]
        coin = not defence.keyed or (told[0]["watched"] and told[0]["coin_keys"])
        return bool(heard and both and coin) and (guard is None or min(self._held()) >= HELD)

    def _held(self) -> list[int]:
        """Keys that each end could give."""
        found = []
        for name, side in ((CONTROLLER_KEYS, "controller"), (PLANT_KEYS, "plant")):
            with KeyStore(self._folder / name, side) as store:  # type: ignore[arg-type]
                found.append(store.available())
        return found

    def attacked(self, text: str, folder: Path, steps: int, seconds: float) -> dict[str, Any]:
        """What came of a copy under this attack."""
        shutil.copytree(self._folder, folder, dirs_exist_ok=True)
        attack = attack_of(text)
        run(self.scenario, self._law, steps, folder, attack, pace="x3", seconds=seconds)
        return told(folder, attack)


def told(folder: Path, attack: Attack | None = None) -> dict[str, Any]:
    """Alarms at each end from the onset on, and how far the plant was from what was read."""
    onset = 0 if attack is None else attack.onset
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
        "spoofed": sum(e.get("true_x_next", e["x_next"]) != e["x_next"] for e in steps),
    }


@pytest.fixture(scope="module")
def law() -> CandidateLaw:
    return designed(scenario_of("keys"))


def test_without_a_guard_covert_is_never_seen(law: CandidateLaw, tmp_path: Path) -> None:
    filled = Filled(tmp_path, law, {"kind": "keyed-coin"})
    found = filled.attacked(f"covert@{filled.onset}", tmp_path / "run", filled.onset + 60, 30.0)
    assert not found["alarms"]
    assert found["away"] > 4


def test_a_mac_stops_covert_before_the_plant_has_moved(law: CandidateLaw, tmp_path: Path) -> None:
    """No rewritten offer is applied, and no session ends over it: every step is missed."""
    filled = Filled(tmp_path, law, {"messages": "mac"})
    found = filled.attacked(f"covert@{filled.onset}", tmp_path / "run", filled.onset + 60, 15.0)
    assert found["forged"]["controller"] == []
    assert found["forged"]["plant"][0] == (filled.onset, "offer")
    assert {message for _, message in found["forged"]["plant"]} == {"offer"}
    assert found["sessions"] == 1
    assert found["last"] < filled.onset
    assert found["away"] == 0


def test_coding_with_a_keyed_coin_shows_covert(law: CandidateLaw, tmp_path: Path) -> None:
    filled = Filled(tmp_path, law, {"kind": "keyed-coin", "messages": "coding"})
    found = filled.attacked(f"covert@{filled.onset}", tmp_path / "run", filled.onset + 40, 30.0)
    assert found["alarms"]
    assert filled.onset < found["alarms"][0] <= filled.onset + 10


@pytest.mark.parametrize("messages", ["mac", "coding"])
def test_an_honest_run_is_guarded_and_nothing_is_refused(
    messages: str, law: CandidateLaw, tmp_path: Path
) -> None:
    filled = Filled(tmp_path, law, {"kind": "keyed-coin", "messages": messages})
    folder = tmp_path / "filled"
    found = told(folder)
    assert not found["alarms"]
    assert found["forged"] == {"plant": [], "controller": []}
    assert filled.scenario.defence.words() == f"keyed-coin + {messages}"


# --- a user's own, live ---------------------------------------------------------------------------

OWN = Path(__file__).with_name("own_defences.py")
EDGE = f"{Path(__file__).parents[2] / 'examples/own/edge.py'}:Edge"
SPOILT = Path(__file__).with_name("spoilt.py")


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
    found = told(tmp_path, made)
    alarms = found["alarms"]
    assert (found["spoofed"] > 0) == (attack is not None)
    assert seen is None or bool(alarms) == seen
    assert all(k >= 30 for k in alarms)


def test_a_guard_of_ones_own_runs_live(law: CandidateLaw, tmp_path: Path) -> None:
    filled = Filled(tmp_path, law, {"messages": f"{OWN}:Flip"})
    status = json.loads((tmp_path / "filled" / CONTROLLER_STATUS).read_bytes())
    assert status["guarded"] > 0
    assert status["forged"] == status["malformed"] == 0
    assert filled.scenario.defence.takes_keys


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
