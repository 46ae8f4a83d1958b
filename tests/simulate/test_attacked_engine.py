"""What would refute theorem 1 of docs/findings.md, and the attacked engine beside a plain loop."""

from typing import Any

import numpy as np
import pytest

from attacker_service.attacks import named
from attacker_service.base import LoopModel
from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from protocol.statistics import clopper_pearson
from studies.attacks.attacked import Attacked, Keys, Kind, attack_runs
from studies.signalling import changed
from tests.support.size import size
from wyner.simulate.engine.loop import SimulationError

pytestmark = pytest.mark.slow

RARE = 1e-6
COIN, CODING, MAC = "keyed-coin", "coding", "mac"


@pytest.fixture(scope="module")
def packed() -> tuple[Scenario, CandidateLaw]:
    return of(changed("packed"))


def of(scenario: Scenario) -> tuple[Scenario, CandidateLaw]:
    return scenario, make_law(scenario, cached_design(scenario))


def making(scenario: Scenario, name: str, **options: Any) -> Kind:
    model, kind = LoopModel.of(scenario), named(name)
    return lambda draw: kind(model, options, draw)


def run(
    loop: tuple[Scenario, CandidateLaw],
    kind: Kind | None,
    *defences: str,
    held: bool = False,
    runs: int = 2000,
    steps: int = 20,
    **more: Any,
) -> Attacked:
    keys = more.pop("keys", Keys(np.full(runs, held)))
    return attack_runs(*loop, kind, defences, keys, seed=[7], steps=steps, **more)


def holds(count: int, runs: int, share: float) -> bool:
    low, high = clopper_pearson(count, runs, RARE)
    return low <= share <= high


# --- theorem 1 ------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [2, 3, 4])
def test_a_fabricator_passes_one_step_in_m(size: int) -> None:
    loop = of(changed("packed", secrecy={"candidates": size}))
    found = run(loop, making(loop[0], "ghost"), COIN, runs=8000, steps=8)
    for n, left in enumerate(found.undetected().tolist()):
        assert holds(left, 8000, float(size) ** -n), (size, n)
    assert found.false_alarms == 0


@pytest.mark.long
def test_an_honest_loop_never_alarms_at_the_corners_of_d_c() -> None:
    for kind in ("corners", "constant"):
        disturbance = {"kind": kind, "half_widths": [0.12, 0.12]}
        loop = of(changed("packed", plant={"disturbance": disturbance}))
        found = run(
            loop,
            None,
            COIN,
            CODING,
            MAC,
            runs=size(200, 1000),
            steps=size(80, 400),
        )
        assert found.false_alarms == 0


# --- who has the key ------------------------------------------------------------------------------


def test_who_has_the_key_is_never_seen(packed: tuple[Scenario, CandidateLaw]) -> None:
    ghost = making(packed[0], "ghost")
    assert (run(packed, ghost, COIN, held=True, steps=40).alarmed == 0).all()
    assert (run(packed, ghost, steps=40).alarmed == 0).all()  # a private coin
    for defence in (CODING, MAC):  # spoofed before the plant's end
        assert (run(packed, ghost, defence, steps=40).alarmed == 0).all()


def test_the_limit_is_never_seen(packed: tuple[Scenario, CandidateLaw]) -> None:
    """She sees the true state exactly, and says that D_c did another thing: no seed helps."""
    bias = making(packed[0], "bias", push=1.0)
    found = run(packed, bias, COIN, CODING, MAC, runs=500, steps=100)
    assert (found.alarmed == 0).all()
    assert found.away.mean() > 28
    assert found.shown.max() < 3


# --- on the bus -----------------------------------------------------------------------------------


def test_covert_is_caught_by_a_fresh_secret_matrix_and_by_a_tag(
    packed: tuple[Scenario, CandidateLaw],
) -> None:
    covert = making(packed[0], "covert", input=0.3)
    free = run(packed, covert, steps=59)
    assert (free.alarmed == 0).all()
    assert free.away.min() > 10
    # A residual of e alone is as if nothing were done: with the model it is undone exactly.
    for defence in (COIN, CODING, MAC):
        assert (run(packed, covert, defence, held=True).alarmed == 0).all()
    assert (run(packed, covert, COIN).alarmed == 0).all()
    coded = run(packed, covert, CODING, COIN)
    assert coded.undetected()[1] == 2000  # x(onset) is as it was
    assert holds(int(coded.undetected()[2]), 2000, 0.287)
    assert (run(packed, covert, MAC).alarmed == 2).all()


# --- the loop itself ------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_runs(packed: tuple[Scenario, CandidateLaw]) -> None:
    ghost = making(packed[0], "ghost")
    one, other = (run(packed, ghost, COIN, runs=300) for _ in range(2))
    assert (one.alarmed == other.alarmed).all()
    assert (one.away == other.away).all()


def test_a_plant_that_the_engine_cannot_step_is_one_line() -> None:
    scenario = changed("pendulum")
    _, law = of(changed("packed"))
    with pytest.raises(SimulationError, match=r"plant.kind: got '.*', expected 'linear'"):
        attack_runs(scenario, law, None, (), Keys(np.zeros(2, bool)), seed=[7], steps=2)
