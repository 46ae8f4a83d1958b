"""`mac` and `coding` live, in lock-step: who rewrites the bus is refused, or seen."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from controller_service.command import designed
from controller_service.laws.base import CandidateLaw
from protocol.scenario import Attack, Scenario, attack_of
from runtime.recording import TraceReader
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from runtime.scenario_file import scenario_of
from tests.campaigns.attacked import run
from wyner.runs.resolve import Resolved

pytestmark = pytest.mark.slow

FILLS = 2400
ONSET = FILLS + 60


class Filled:
    """A run that has made keys, under a defence; copies of it go on."""

    def __init__(self, folder: Path, law: CandidateLaw, defence: dict[str, str]) -> None:
        tables = scenario_of("keys").model_dump(exclude_unset=True)
        self.scenario = Scenario.model_validate(tables | {"defence": defence})
        self._law, self._folder = law, folder / "filled"
        self._folder.mkdir()
        run(self.scenario, law, FILLS, self._folder)

    def attacked(self, text: str, folder: Path, steps: int, seconds: float) -> dict[str, Any]:
        """What came of a copy under this attack."""
        shutil.copytree(self._folder, folder, dirs_exist_ok=True)
        attack = attack_of(text)
        run(self.scenario, self._law, steps, folder, attack, seconds=seconds)
        return told(folder, attack)


def told(folder: Path, attack: Attack | None = None) -> dict[str, Any]:
    """Alarms at each end from the onset on, and how far the plant was from what was read."""
    onset = 0 if attack is None else attack.onset
    lines = {
        side: list(Resolved(TraceReader(folder / name).lines()))
        for side, name in (("plant", PLANT_TRACE), ("controller", CONTROLLER_TRACE))
    }
    read = {e["k"] + 1: e["x_next"] for e in lines["controller"] if e["event"] == "transition"}
    away = [
        max(abs(a - b) for a, b in zip(e["x_next"], read[e["k"] + 1], strict=True))
        for e in lines["plant"]
        if e["event"] == "transition" and e["k"] + 1 in read
    ]
    return {
        "alarms": [e["k"] + 1 for e in lines["controller"] if e["event"] == "alarm"],
        "forged": {
            side: [(e["k"], e["message"]) for e in events if e["event"] == "forged"]
            for side, events in lines.items()
        },
        "last": max(e["k"] for e in lines["plant"] if e["event"] == "transition"),
        "away": max(away, default=0.0),
        "onset": onset,
    }


@pytest.fixture(scope="module")
def law() -> CandidateLaw:
    return designed(scenario_of("keys"))


def test_without_a_guard_covert_is_never_seen(law: CandidateLaw, tmp_path: Path) -> None:
    filled = Filled(tmp_path, law, {"kind": "keyed-coin"})
    found = filled.attacked(f"covert@{ONSET}", tmp_path / "run", ONSET + 60, 30.0)
    assert not found["alarms"]
    assert found["away"] > 4


def test_a_mac_stops_covert_before_the_plant_has_moved(law: CandidateLaw, tmp_path: Path) -> None:
    """No rewritten offer is applied: in lock-step the loop stands still."""
    filled = Filled(tmp_path, law, {"messages": "mac"})
    found = filled.attacked(f"covert@{ONSET}", tmp_path / "run", ONSET + 60, 8.0)
    assert found["forged"] == {"plant": [(ONSET, "offer")], "controller": []}
    assert found["last"] < ONSET
    assert found["away"] == 0


def test_coding_with_a_keyed_coin_shows_covert(law: CandidateLaw, tmp_path: Path) -> None:
    filled = Filled(tmp_path, law, {"kind": "keyed-coin", "messages": "coding"})
    found = filled.attacked(f"covert@{ONSET}", tmp_path / "run", ONSET + 40, 30.0)
    assert found["alarms"]
    assert ONSET < found["alarms"][0] <= ONSET + 10


@pytest.mark.parametrize("messages", ["mac", "coding"])
def test_an_honest_run_is_guarded_and_passes_the_check(
    messages: str, law: CandidateLaw, tmp_path: Path
) -> None:
    filled = Filled(tmp_path, law, {"kind": "keyed-coin", "messages": messages})
    folder = tmp_path / "filled"
    found = told(folder)
    assert not found["alarms"]
    assert found["forged"] == {"plant": [], "controller": []}
    assert filled.scenario.defence.words() == f"keyed-coin + {messages}"
