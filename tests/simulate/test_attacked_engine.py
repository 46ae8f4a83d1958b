"""What would refute theorem 1 of docs/findings.md, and the attacked engine beside a plain loop."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from attacker_service.attacks import named
from attacker_service.base import UNKNOWN, Attack, Model, Observation, SensorAttack
from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import INSIDE, Gauge
from protocol.arrays import Array
from protocol.plugins import UnknownError
from protocol.scenario import Scenario
from protocol.statistics import clopper_pearson
from studies.attacks.attacked import Attacked, Keys, Kind, attack_runs
from studies.attacks.defences import (
    DEFENCES,
    Coding,
    Defence,
    KeyedCoin,
    Mac,
    StaticCoding,
    make_defence,
)
from studies.attacks.learner import rotation_learner
from studies.signalling import changed
from tests.support.size import size
from wyner.simulate.engine.loop import SimulationError

pytestmark = pytest.mark.slow

RARE = 1e-6


@pytest.fixture(scope="module")
def packed() -> tuple[Scenario, CandidateLaw]:
    return of(changed("packed"))


def of(scenario: Scenario) -> tuple[Scenario, CandidateLaw]:
    return scenario, make_law(scenario, cached_design(scenario))


def making(scenario: Scenario, name: str, **options: Any) -> Kind:
    model, kind = Model.of(scenario), named(name)
    return lambda draw: kind(model, options, draw)


def run(
    loop: tuple[Scenario, CandidateLaw],
    kind: Kind | None,
    *defences: Defence,
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
    found = run(loop, making(loop[0], "ghost"), KeyedCoin(2, size), runs=8000, steps=8)
    for n, left in enumerate(found.undetected().tolist()):
        assert holds(left, 8000, float(size) ** -n), (size, n)
    assert found.false_alarms == 0


@pytest.mark.long
def test_the_tank_has_sixteen_candidates_in_two_inputs() -> None:
    loop = of(changed("packed-quadruple-tank"))
    runs = size(1000, 3000)
    found = run(loop, making(loop[0], "ghost"), KeyedCoin(4, 16), runs=runs, steps=2, onset=4)
    assert holds(int(found.undetected()[1]), runs, 1 / 16)
    assert holds(int(found.undetected()[2]), runs, 1 / 256)


class Cunning(SensorAttack):
    """Any x' that does not depend on the coin: between two predictions, on an edge, far out."""

    name = "cunning"

    def sensor(self, told: Observation) -> Array:
        assert told.candidates is not None
        c = self.model.predict(told.shown[:, None, :], told.candidates)
        runs, size = c.shape[:2]
        weights = self.rng.dirichlet(np.full(size, 0.2), size=runs)
        mixed = (weights[..., None] * c).sum(1)
        edge = self.rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], size=mixed.shape)
        pick = c[np.arange(runs), self.rng.integers(size, size=runs)]
        chosen = np.where(self.rng.random((runs, 1)) < 0.3, mixed, pick)
        return np.asarray(chosen + edge * self.model.half_widths)


def test_no_reading_fits_two_candidates(packed: tuple[Scenario, CandidateLaw]) -> None:
    model = Model.of(packed[0])
    found = run(packed, lambda draw: Cunning(model, {}, draw), KeyedCoin(2, 4), runs=8000, steps=6)
    for n, left in enumerate(found.undetected().tolist()):
        assert clopper_pearson(left, 8000, RARE)[0] <= 4.0**-n, n
    assert found.undetected()[1] > 0  # some of what Eve says is within D_c of a prediction


@pytest.mark.parametrize("size", [2, 3, 4])
def test_predictions_of_the_alphabet_never_overlap(size: int) -> None:
    """One x' within D_c of two of them would refute the proof."""
    scenario = changed("packed", secrecy={"candidates": size})
    offsets = cached_design(scenario).offsets
    assert offsets is not None
    gauge = Gauge.from_rows(*scenario.defender.disturbance.rows())
    push = (np.array(scenario.B) @ np.diff(offsets, axis=0).T).T
    for step in push.tolist():
        # the best x' for both is halfway, and is outside of each
        assert gauge([v / 2 for v in step]) > INSIDE


@pytest.mark.long
def test_an_honest_loop_never_alarms_at_the_corners_of_d_c() -> None:
    for kind in ("corners", "constant"):
        disturbance = {"kind": kind, "half_widths": [0.12, 0.12]}
        loop = of(changed("packed", plant={"disturbance": disturbance}))
        found = run(
            loop,
            None,
            KeyedCoin(2, 4),
            Coding(2, 4),
            Mac(2, 4),
            runs=size(200, 1000),
            steps=size(80, 400),
        )
        assert found.false_alarms == 0


def test_a_disturbance_that_leaves_d_c_does_alarm() -> None:
    disturbance = {
        "kind": "uniform",
        "half_widths": [0.1, 0.14],
        "may_leave_defender_set": True,
    }
    loop = of(changed("packed", plant={"disturbance": disturbance}))
    assert run(loop, None, KeyedCoin(2, 4), runs=200, steps=100).false_alarms > 1000


# --- who has the key ------------------------------------------------------------------------------


def test_who_has_the_key_is_never_seen(packed: tuple[Scenario, CandidateLaw]) -> None:
    ghost = making(packed[0], "ghost")
    assert (run(packed, ghost, KeyedCoin(2, 4), held=True, steps=40).alarmed == 0).all()
    assert (run(packed, ghost, steps=40).alarmed == 0).all()  # a private coin
    for defence in (Coding(2, 4), Mac(2, 4)):  # spoofed before the plant's end
        assert (run(packed, ghost, defence, steps=40).alarmed == 0).all()


def test_the_limit_is_never_seen(packed: tuple[Scenario, CandidateLaw]) -> None:
    """She sees the true state exactly, and says that D_c did another thing: no seed helps."""
    bias = making(packed[0], "bias", push=1.0)
    found = run(packed, bias, KeyedCoin(2, 4), Coding(2, 4), Mac(2, 4), runs=500, steps=100)
    assert (found.alarmed == 0).all()
    assert found.away.mean() > 28
    assert found.shown.max() < 3


def test_some_of_the_keys_catch_her_in_some_of_the_runs(
    packed: tuple[Scenario, CandidateLaw],
) -> None:
    keys = Keys(np.arange(2000) < 700)
    found = run(packed, making(packed[0], "ghost"), KeyedCoin(2, 4), keys=keys, steps=30)
    assert (found.alarmed[:700] == 0).all()
    assert (found.alarmed[700:] > 0).all()


def test_what_she_believes_wrongly_catches_her(packed: tuple[Scenario, CandidateLaw]) -> None:
    digits = np.random.default_rng(7).integers(4, size=(60, 500))
    believed = digits.copy()
    believed[40:, :100] = (digits[40:, :100] + 1) % 4  # wrong from step 40 on
    believed[:, 100:200] = UNKNOWN
    keys = Keys(np.zeros(500, bool), digits, believed)
    found = run(packed, making(packed[0], "ghost"), KeyedCoin(2, 4), keys=keys, steps=25, onset=30)
    assert (found.alarmed[:100] == 12).all()  # the reading of step 41 tells of the coin of 40
    assert (found.alarmed[100:200] > 0).all()
    assert (found.alarmed[200:] == 0).all()


# --- on the bus -----------------------------------------------------------------------------------


def test_covert_is_caught_by_a_fresh_secret_matrix_and_by_a_tag(
    packed: tuple[Scenario, CandidateLaw],
) -> None:
    covert = making(packed[0], "covert", input=0.3)
    free = run(packed, covert, steps=59)
    assert (free.alarmed == 0).all()
    assert free.away.min() > 10
    # A residual of e alone is as if nothing were done: with the model it is undone exactly.
    for defence in (KeyedCoin(2, 4), Coding(2, 4), Mac(2, 4)):
        assert (run(packed, covert, defence, held=True).alarmed == 0).all()
    assert (run(packed, covert, KeyedCoin(2, 4)).alarmed == 0).all()
    coded = run(packed, covert, Coding(2, 4), KeyedCoin(2, 4))
    assert coded.undetected()[1] == 2000  # x(onset) is as it was
    assert holds(int(coded.undetected()[2]), 2000, 0.287)
    assert (run(packed, covert, Mac(2, 4)).alarmed == 2).all()


def test_one_matrix_is_learnt_from_two_steps(packed: tuple[Scenario, CandidateLaw]) -> None:
    covert = making(packed[0], "covert", input=0.3)
    keys = Keys(np.zeros(50, bool), learn=rotation_learner(packed[1]))
    assert (run(packed, covert, StaticCoding(2, 4), keys=keys, steps=40).alarmed == 0).all()
    guessed = run(packed, covert, StaticCoding(2, 4), steps=40)
    assert (guessed.alarmed > 0).mean() > 0.7


# --- the loop itself ------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_runs(packed: tuple[Scenario, CandidateLaw]) -> None:
    ghost = making(packed[0], "ghost")
    one, other = (run(packed, ghost, KeyedCoin(2, 4), runs=300) for _ in range(2))
    assert (one.alarmed == other.alarmed).all()
    assert (one.away == other.away).all()
    assert one.brief()["undetected"] == int((one.alarmed == 0).sum())


def test_a_plant_that_the_engine_cannot_step_is_one_line() -> None:
    scenario = changed("pendulum")
    _, law = of(changed("packed"))
    with pytest.raises(SimulationError, match=r"plant.kind: got '.*', expected 'linear'"):
        attack_runs(scenario, law, None, (), Keys(np.zeros(2, bool)), seed=[7], steps=2)


# --- a defence of one's own -----------------------------------------------------------------------

TOY = '''
"""Alarms where x(k+1) is nearer to the edge of D_c than a disturbance of this plant ever comes."""

from studies.attacks.defences import Defence


class Suspicious(Defence):
    name = "suspicious"

    def alarm(self, session, step, gauges):
        return gauges.min(-1) > 0.84
'''


def test_a_defence_in_a_file_of_ones_own(
    packed: tuple[Scenario, CandidateLaw], tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(TOY)
    mine = make_defence(f"{tmp_path / 'mine.py'}:Suspicious", 2, 4)
    assert mine.key_bits == 0
    assert run(packed, None, mine, runs=500, steps=50).false_alarms == 0  # D is 0.83 of D_c
    push = making(packed[0], "bias", push=1.0)
    assert (run(packed, push, mine).alarmed == 1).all()
    assert (run(packed, making(packed[0], "bias", push=0.8), mine).alarmed == 0).all()
    with pytest.raises(UnknownError, match=r"got 'nothing', expected residual, keyed-coin"):
        make_defence("nothing", 2, 4)
    (tmp_path / "none.py").write_text("Suspicious = 3\n")
    with pytest.raises(UnknownError, match="expected a class Suspicious that extends"):
        make_defence(f"{tmp_path / 'none.py'}:Suspicious", 2, 4)


def test_every_defence_states_its_key() -> None:
    costs = {name: make_defence(name, 2, 4).key_bits for name in DEFENCES}
    assert costs == {
        "residual": 0,
        "keyed-coin": 2,
        "coding": 32,
        "static-coding": 0,
        "mac": 64,
    }
    assert make_defence("keyed-coin", 2, 3).key_bits == pytest.approx(math.log2(3))


def test_every_attack_is_one(packed: tuple[Scenario, CandidateLaw]) -> None:
    assert all(issubclass(named(name), Attack) for name in ("ghost", "replay", "stuck"))
