"""The safety and liveness of the link, on a seeded faulty network with processes that die.

A failing seed is printed with its test and replays: everything random comes from it.
"""

import sqlite3
from pathlib import Path
from typing import Any

import pytest

from controller_service.laws.base import CandidateLaw
from protocol.link.effects import Save
from protocol.link.step import Read
from protocol.scenario import Scenario
from runtime.journal import PlantJournal
from tests.support.safety import violations
from tests.support.size import size
from wyner.simulate.faults import Faults
from wyner.simulate.network import Simulation, simulate

PAYLOADS = (b"first", b"second message", b"3")

NETWORKS = {
    "clean": Faults(),
    "loses": Faults(loss=0.4, until_s=60),
    "repeats": Faults(repeat=0.5, until_s=60),
    "reorders": Faults(delay_s=0.4, repeat=0.3, until_s=60),
    "crashes": Faults(crash=0.02, until_s=60),
    "forgets": Faults(crash=0.02, amnesia=0.5, until_s=60),
    "everything": Faults(0.2, 0.2, 0.15, 0.02, 0.2, until_s=60),
}


@pytest.mark.parametrize("step_s", [None, 0.1], ids=["lockstep", "deadlines"])
@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("seed", size([0], [0, 1]))
def test_safety_always_and_delivery_once_all_is_well(
    network: str, seed: int, step_s: float | None, sustained: Scenario, sustained_law: CandidateLaw
) -> None:
    faults = NETWORKS[network]
    sim = Simulation(
        sustained, sustained_law, seed=seed, payloads=PAYLOADS, faults=faults, step_s=step_s
    )
    history = sim.run(seconds=900, until=lambda: len(sim.history.delivered) >= len(PAYLOADS))
    assert list(violations(history, PAYLOADS)) == []
    assert [history.delivered.index(i) for i in range(3)] == [0, 1, 2]
    if not faults.amnesia:
        assert history.inbox == list(PAYLOADS)
    if faults.crash:
        assert history.crashes > 0
    if faults.loss and step_s is not None:
        assert history.missed > 0


def test_without_faults_nothing_is_missed_and_time_does_not_pass(
    sustained: Scenario, sustained_law: CandidateLaw
) -> None:
    history = simulate(sustained, sustained_law, seed=7, steps=2000, payload=b"abc")
    assert len(history.plant) == len(history.controller) == 2000
    assert history.missed == 0
    assert history.inbox == [b"abc"]
    assert all(t.symbol == t.coin for t in history.plant.values() if t.symbol >= 0)


def test_a_seed_replays(sustained: Scenario, sustained_law: CandidateLaw) -> None:
    def once() -> object:
        sim = Simulation(
            sustained, sustained_law, seed=3, payloads=PAYLOADS, faults=NETWORKS["everything"]
        )
        history = sim.run(seconds=20)
        return history.plant, history.controller, history.crashes, history.inbox

    assert once() == once()


def test_the_check_finds_what_it_looks_for(
    sustained: Scenario, sustained_law: CandidateLaw
) -> None:
    history = simulate(sustained, sustained_law, seed=1, steps=600, payload=b"x")
    assert list(violations(history, (b"x",))) == []
    at, t = next((at, t) for at, t in history.plant.items() if t.role == "message")
    history.plant[at] = t._replace(message_symbol=1 - t.message_symbol)
    assert "transition" in next(violations(history, (b"x",)))
    history.plant[at] = t
    j, carries, offer = next(o for o in history.offered if o[1])
    history.offered.append((j, carries, offer.model_copy(update={"cipher": 1 - offer.cipher})))
    assert "cipher" in next(violations(history, (b"x",)))
    history.offered.pop()
    assert "arrived" in next(violations(history, (b"y",)))
    del history.controller[at]
    assert "gap" in next(violations(history, (b"x",)))


class Watched(PlantJournal):
    """A plant's journal that counts the statements of each step's write."""

    def __init__(self, path: Path, scenario: str, executed: list[str]) -> None:
        super().__init__(path, scenario)
        self._executed = executed
        self.of_steps: list[int] = []

    def save(self, save: Save) -> None:
        before = len(self._executed)
        super().save(save)
        if isinstance(save.step, Read) and not save.durable:
            self.of_steps.append(len(self._executed) - before)

    def forget(self) -> None:
        raise AssertionError("nobody forgets")


def test_what_the_plant_saves_has_the_same_shape_in_both_states(
    sustained: Scenario,
    sustained_law: CandidateLaw,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Were a save in one state more work, the time of the next measurement would tell."""
    executed: list[str] = []
    connect = sqlite3.connect

    def watched(*args: Any, **options: Any) -> sqlite3.Connection:
        connection: sqlite3.Connection = connect(*args, **options)
        connection.set_trace_callback(executed.append)
        return connection

    monkeypatch.setattr(sqlite3, "connect", watched)
    with Watched(tmp_path / "j", sustained.fingerprint(), executed) as journal:
        payloads = (b"a" * 40,)
        sim = Simulation(sustained, sustained_law, seed=2, payloads=payloads, plant_journal=journal)
        history = sim.run(steps=1000)
        assert journal.load().symbols
    roles = [t.role for t in history.plant.values()]
    assert set(roles) == {"test", "message"}
    assert 0 <= len(roles) - len(journal.of_steps) <= len(payloads), "of a last symbol"
    assert set(journal.of_steps) == {1}, "one row, which is a transaction"
