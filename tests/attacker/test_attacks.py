"""The shipped attacks over many runs at once, against what is known of them in closed form.

What would refute theorem 1 of docs/findings.md is among it. The loop is that of the studies.
"""

from dataclasses import replace
from functools import cache
from math import erf, sqrt
from typing import Any

import numpy as np
import pytest

from attacker_service.attacks import named
from attacker_service.attacks.covert import Covert
from attacker_service.attacks.ghost import Ghost
from attacker_service.attacks.stuck import Stuck
from attacker_service.base import UNKNOWN, AttackError, LoopModel, Observation
from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.arrays import Array
from protocol.scenario import Scenario
from protocol.statistics import clopper_pearson
from studies.attacks.attacked import Attacked, Keys, attack_runs
from studies.signalling import changed
from tests.support.size import size
from wyner.simulate.engine.loop import SimulationError

RARE = 1e-6
COIN, CODING, MAC = "keyed-coin", "coding", "mac"
NONE: dict[str, Any] = {}
STILL: dict[str, Any] = {"disturbance": {"half_widths": [0.0, 0.0]}}


def rng(seed: int = 7) -> np.random.Generator:
    return np.random.default_rng(seed)


@cache
def loop_of(candidates: int = 4, alpha: float = 8.0) -> tuple[Scenario, CandidateLaw]:
    """The paper's plant under the packed law, and the law."""
    scenario = changed("packed", secrecy={"candidates": candidates, "alpha": alpha})
    return scenario, make_law(scenario, cached_design(scenario))


def model() -> LoopModel:
    """Who knows all of it."""
    return LoopModel.of(loop_of()[0])


def run(
    kind: str | None,
    *defences: str,
    loop: tuple[Scenario, CandidateLaw] | None = None,
    known: LoopModel | None = None,
    options: dict[str, Any] = NONE,
    held: bool = False,
    runs: int = 2000,
    steps: int = 20,
    **more: Any,
) -> Attacked:
    """Runs under an attack, of one who knows the loop's model if no other is given."""
    scenario, law = loop or loop_of()
    knows, keys = known or LoopModel.of(scenario), more.pop("keys", Keys(np.full(runs, held)))
    made = None if kind is None else lambda draw: named(kind)(knows, options, draw)
    return attack_runs(scenario, law, made, defences, keys, seed=[7], steps=steps, **more)


def holds(count: int, runs: int, share: float) -> bool:
    low, high = clopper_pearson(count, runs, RARE)
    return low <= share <= high


def passes(found: Attacked, share: float) -> bool:
    """Whether each step passes with the same probability, whatever passed before it."""
    undetected = found.undetected().tolist()
    return all(holds(left, undetected[0], share**n) for n, left in enumerate(undetected))


# --- one who fabricates readings ------------------------------------------------------------------


@pytest.mark.parametrize("candidates", [2, 3, 4])
def test_a_ghost_without_the_key_passes_a_step_once_in_m(candidates: int) -> None:
    found = run("ghost", COIN, loop=loop_of(candidates), runs=8000, steps=8)
    assert passes(found, 1 / candidates)
    assert found.false_alarms == 0


def test_a_ghost_with_the_key_is_never_caught_and_the_plant_walks_away() -> None:
    found = run("ghost", COIN, held=True, steps=40)
    assert (found.alarmed == 0).all()
    assert found.away.min() > 3
    assert (run("ghost", steps=40).alarmed == 0).all()  # a private coin
    for defence in (CODING, MAC):  # spoofed before the plant's end
        assert (run("ghost", defence, steps=40).alarmed == 0).all()


def test_a_key_that_she_holds_in_part_helps_in_part() -> None:
    """A coin held with probability q passes with q + (1 - q) / M."""
    runs, steps, draw = 8000, 3, rng(1)
    digits = draw.integers(4, size=(40, runs))
    believed = np.where(draw.random(digits.shape) < 0.3, digits, UNKNOWN)
    found = run("ghost", COIN, keys=Keys(np.zeros(runs, bool), digits, believed), steps=steps)
    assert passes(found, 0.3 + 0.7 / 4)


@pytest.mark.parametrize("sees", [0.06, 0.12, 0.24])
@pytest.mark.parametrize("candidates", [2, 4])
def test_a_ghost_that_sees_the_plant_passes_as_often_as_she_sees_the_coin(
    sees: float, candidates: int
) -> None:
    """There is no disturbance, and she knows: she names the nearest of M points on a line."""
    scenario, law = loop_of(candidates)
    B, known = np.array(scenario.B), LoopModel.of(scenario)
    points = law.candidates_many(np.zeros((1, 2)), law.indices(np.zeros((1, 2))))[0, :, 0]
    away = float(np.hypot(*B[:, 0])) * abs(points[1] - points[0]) / (2 * sees)
    phi = (1 + erf(away / sqrt(2))) / 2
    found = run(
        "ghost",
        COIN,
        loop=(changed("packed", plant=STILL, secrecy={"candidates": candidates}), law),
        known=replace(known, disturbance_h=known.disturbance_h * 1e-9),
        options={"sees": sees, "push": 0.0, "share": 0.0},
        runs=8000,
        steps=3,
    )
    assert passes(found, (2 * phi + (candidates - 2) * (2 * phi - 1)) / candidates)


def test_the_limit_is_never_seen() -> None:
    """She sees the true state exactly, and says that D_c did another thing: no seed helps."""
    found = run("bias", COIN, CODING, MAC, options={"push": 1.0}, runs=500, steps=100)
    assert (found.alarmed == 0).all()
    assert found.away.mean() > 28
    assert found.shown.max() < 3


def test_a_replay_is_caught_as_a_guess_is() -> None:
    undetected = run("replay", COIN, options={"length": 3}, steps=12).undetected()
    assert undetected[1] < 0.3 * 2000
    assert undetected[-1] == 0


@pytest.mark.long
def test_an_honest_loop_never_alarms_at_the_corners_of_d_c() -> None:
    for kind in ("corners", "constant"):
        disturbance = {"kind": kind, "half_widths": [0.12, 0.12]}
        loop = changed("packed", plant={"disturbance": disturbance}), loop_of()[1]
        runs, steps = size(200, 1000), size(80, 400)
        assert run(None, COIN, CODING, MAC, loop=loop, runs=runs, steps=steps).false_alarms == 0


# --- on the bus -----------------------------------------------------------------------------------


def test_covert_is_caught_by_a_fresh_secret_matrix_and_by_a_tag() -> None:
    covert: dict[str, Any] = {"options": {"input": 0.3}}
    free = run("covert", steps=59, **covert)
    assert (free.alarmed == 0).all()
    assert free.away.min() > 10
    # A residual of e alone is as if nothing were done: with the model it is undone exactly.
    for defence in (COIN, CODING, MAC):
        assert (run("covert", defence, held=True, **covert).alarmed == 0).all()
    assert (run("covert", COIN, **covert).alarmed == 0).all()
    coded = run("covert", CODING, COIN, **covert)
    assert coded.undetected()[1] == 2000  # x(onset) is as it was
    assert holds(int(coded.undetected()[2]), 2000, 0.287)
    assert (run("covert", MAC, **covert).alarmed == 2).all()


def test_covert_stays_in_u_and_follows_a_step_that_was_missed() -> None:
    covert, known = Covert(model(), {"input": (0.5,)}, rng()), model()
    edge = np.array([[5.8], [1.0]])
    assert np.allclose(covert.toward_plant(3, edge), edge + 0.2)
    x, yes = np.zeros(2), np.array(True)
    assert np.allclose(covert.toward_controller(4, x, yes), -0.2 * known.B[:, 0])
    first = covert.toward_controller(4, x, yes)
    covert.toward_plant(4, edge)
    missed = covert.toward_controller(5, x, np.array(False))
    assert np.allclose(missed, known.A @ first)


# --- one by one -----------------------------------------------------------------------------------


def test_stuck_keeps_the_last_input_or_a_value() -> None:
    stuck = Stuck(None, NONE, rng())
    stuck.watch_input(np.array([0.7]))
    assert stuck.actuator(np.array([-1.0])) == 0.7
    assert Stuck(None, {"value": [2.0]}, rng()).actuator(np.array([1.0])) == 2.0


def test_without_an_offer_the_ghost_rolls_on() -> None:
    ghost = Ghost(model(), {"push": 0.0, "share": 0.0}, rng())
    x: Array = np.array([1.0, 2.0])
    assert np.allclose(ghost.sensor(Observation(5, x)), model().A @ x)


@pytest.mark.parametrize(
    ("kind", "knows", "options", "line"),
    [
        ("ghost", False, NONE, "attack.knows: ghost needs 'model'"),
        ("bias", True, {"sees": 0.1}, "attack.sees: got 0.1, "),
        ("ghost", True, {"share": 2}, "attack.share: got 2, "),
        ("ghost", True, {"share": 0.2}, "attack.push: ghost: expected at most 1 together"),
        ("ghost", True, {"direction": [1]}, "attack.direction: got [1.0], expected 2 numbers"),
        ("replay", False, {"share": 2}, "attack.share: got 2, "),
        ("covert", True, {"input": (1.0, 2.0)}, "attack.input: got [1.0, 2.0], expected 1"),
    ],
)
def test_what_does_not_fit_is_one_line(
    kind: str, knows: bool, options: dict[str, Any], line: str
) -> None:
    with pytest.raises(AttackError) as caught:
        named(kind)(model() if knows else None, options, rng())
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


def test_a_plant_that_the_engine_cannot_step_is_one_line() -> None:
    with pytest.raises(SimulationError, match=r"plant.kind: got '.*', expected 'linear'"):
        run(None, loop=(changed("pendulum"), loop_of()[1]), runs=2, steps=2)
