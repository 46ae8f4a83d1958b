"""Who rewrites the bus is never seen: both ends are the services', and time is virtual."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest

from attacker_service.attacker import Attacker
from protocol.scenario import attack_of
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from tests.support.recorded_pair import RecordedPair
from tests.support.traces import events_of

pytestmark = pytest.mark.slow

LOOK = 5
"""Steps in a row that are watched before an attack begins."""

KEYED = '\n[defence]\ncoin = "keys"\n'


def told(folder: Path) -> dict[str, Any]:
    """Alarms, and how far the plant was from what was read."""
    plant, controller = folder / PLANT_TRACE, folder / CONTROLLER_TRACE
    steps = events_of(plant, "transition")
    counted = events_of(controller, "transition")
    read = {e["k"] + 1: e["x_next"] for e in counted}
    away = [
        max(abs(a - b) for a, b in zip(e["x_next"], read[e["k"] + 1], strict=True))
        for e in steps
        if e["k"] + 1 in read
    ]
    return {
        "alarms": events_of(controller, "alarm"),
        "away": max(away, default=0.0),
        "watched": sum(e.get("expected", -1) >= 0 for e in counted),
    }


def test_covert_is_never_seen_by_a_keyed_coin(tmp_path: Path) -> None:
    attack = attack_of("covert@1")
    loop = RecordedPair(tmp_path, name="keys", more=KEYED)

    def steps(number: int) -> int:
        """Steps of the next so many that a key chose the input of."""
        watched = 0
        for _ in range(number):
            loop.run(partial(is_at, loop.plant.state.record.link.k + 1))
            watched += loop.plant.state.record.applied.keyed
        return watched

    def is_at(k: int) -> bool:
        return loop.plant.state.record.link.k >= k

    while steps(LOOK) < LOOK:
        assert loop.plant.state.record.link.k < 5000, "keys never come"
    attacker = Attacker(loop.scenario, attack, None)
    loop.relay = attacker
    assert steps(60) == 60
    assert attacker.failed == ""
    loop.stop()
    found = told(tmp_path)
    assert not found["alarms"]
    assert found["away"] > 4
    assert found["watched"] >= 60


def test_covert_over_a_network_that_loses_is_labelled_and_never_seen(tmp_path: Path) -> None:
    """It rewrites what leaves; a message that is lost after it moves nothing, as it reckons."""
    attack = attack_of("covert@50")
    loop = RecordedPair(tmp_path, name="network", attack=attack)
    attacker = Attacker(loop.scenario, attack, None)
    loop.relay = attacker
    loop.run(lambda: loop.plant.state.record.link.k >= 200)
    assert attacker.failed == ""
    loop.stop()
    found = told(tmp_path)
    missed = events_of(tmp_path / PLANT_TRACE, "missed")
    assert len(missed) > 5
    assert not found["alarms"]
    assert found["away"] > 4
    assert loop.wrong() == []
