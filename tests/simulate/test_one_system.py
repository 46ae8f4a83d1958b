"""Every shipped scenario: the engine's run is the cores', to the last bit, of seeds of its own."""

import random

import pytest

from wyner.api import design, load, scenario_names
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.network import Simulation

STEPS = 60
"""Fewer than a block of keys has: from then on a keyed coin is the cores' alone."""


def held_out(name: str) -> tuple[int, int]:
    """A seed and the number of a run."""
    draw = random.Random(f"held out {name}")
    return draw.randrange(2**31), draw.randrange(5)


def without_keys() -> list[str]:
    """The scenarios in which no key chooses or seals anything: the engine makes none."""
    found = ((name, load(name)) for name in scenario_names())
    return [n for n, s in found if s.secrecy.scheme != "sealed" and s.defence.coin == "private"]


@pytest.mark.parametrize("name", without_keys())
def test_engine_and_cores_are_one_system(name: str) -> None:
    system = design(name)
    scenario, (seed, run) = system.scenario, held_out(name)
    record = simulate_runs(
        scenario,
        system.law,
        seed=seed,
        runs=range(run, run + 1),
        steps=STEPS,
        record=True,
        folder=system.folder,
    )
    link = transfer(record, payloads=[b"ok"])
    ends = Simulation(
        scenario,
        system.law,
        seed=seed,
        run=run,
        payloads=(b"ok",),
        step_s=None if scenario.network is None else scenario.plant.period_s,
        folder=system.folder,
    )
    history = ends.run(steps=STEPS)
    assert record.x is not None
    assert record.candidates is not None
    done = [t for t in history.plant.values() if t.k < STEPS]
    missed = [] if record.missed is None else record.missed[:, 0].nonzero()[0].tolist()
    assert [t.k for t in done] == [k for k in range(STEPS) if k not in missed]
    for t in done:
        assert t.x == tuple(record.x[t.k, :, 0])
        assert t.candidates == tuple(map(tuple, record.candidates[t.k, :, :, 0].tolist()))
        assert t.x_next == tuple(record.x[t.k + 1, :, 0])
        assert t.coin == record.coin[t.k, 0]
        assert t.cipher == link.cipher[t.k, 0]
        assert (t.symbol, t.key) == (link.agreed[t.k, 0], link.pad[t.k, 0])
        assert t.message_symbol == link.message_symbol[t.k, 0]
