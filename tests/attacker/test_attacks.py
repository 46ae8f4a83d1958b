"""The shipped attacks over many runs at once, against what is known of them in closed form."""

from math import erf, sqrt
from typing import Any

import numpy as np
import pytest

from attacker_service.attacks import named
from attacker_service.attacks.bias import Bias
from attacker_service.attacks.covert import Covert
from attacker_service.attacks.ghost import Ghost
from attacker_service.attacks.replay import Replay
from attacker_service.attacks.stuck import Stuck
from attacker_service.base import AttackError, Observation
from protocol.arrays import Array
from tests.attacker.watched import SPACING, WIDTHS, A, B, model, rewritten, spoofed

NONE: dict[str, Any] = {}


def rng(seed: int = 7) -> np.random.Generator:
    return np.random.default_rng(seed)


def within_binomial_error(share: float, p: float, runs: int) -> bool:
    return abs(share - p) <= 4.5 * sqrt(p * (1 - p) / runs) + 1 / runs


@pytest.mark.parametrize("size", [2, 3, 4, 16])
def test_a_ghost_without_the_key_passes_a_step_once_in_M(size: int) -> None:
    undetected = spoofed(Ghost(model(), NONE, rng()), 5, size=size).undetected
    for n, share in enumerate(undetected, 1):
        assert within_binomial_error(float(share), size**-n, 40_000), (n, share)


def test_a_ghost_with_the_key_is_never_caught_and_the_plant_walks_away() -> None:
    seen = spoofed(Ghost(model(), NONE, rng()), 40, runs=2000, held=1.0)
    assert not seen.alarms.any()
    assert seen.off[-1].min() > 3
    assert seen.off[0].max() < 0.5


def test_a_key_that_she_holds_in_part_helps_in_part() -> None:
    """A coin held with probability q passes with q + (1 - q) / M."""
    undetected = spoofed(Ghost(model(), NONE, rng()), 3, held=0.3).undetected
    for n, share in enumerate(undetected, 1):
        assert within_binomial_error(float(share), (0.3 + 0.7 / 4) ** n, 40_000)


def closed_form(sees: float, size: int) -> float:
    """Of one who sees B u_b with noise: nearest of M points on a line."""
    a = float(np.hypot(*B[:, 0])) * SPACING / (2 * sees)
    phi = (1 + erf(a / sqrt(2))) / 2
    return (2 * phi + (size - 2) * (2 * phi - 1)) / size


@pytest.mark.parametrize("sees", [0.06, 0.12, 0.24])
@pytest.mark.parametrize("size", [2, 4])
def test_a_ghost_that_sees_the_plant_passes_as_often_as_she_sees_the_coin(
    sees: float, size: int
) -> None:
    """Her disturbance is known: there is none. A model of a still plant makes her filter exact."""
    still = model(WIDTHS * 1e-9)
    ghost = Ghost(still, {"sees": sees, "push": 0.0, "share": 0.0}, rng())
    seen = spoofed(ghost, 3, size=size, sees=sees, d=np.zeros(2))
    p = closed_form(sees, size)
    for n, share in enumerate(seen.undetected, 1):
        assert within_binomial_error(float(share), p**n, 40_000), (n, share, p**n)


def test_the_limit_one_who_sees_all_is_never_caught() -> None:
    bias = Bias(model(), NONE, rng())
    seen = spoofed(bias, 100, runs=500, sees=0.0)
    assert not seen.alarms.any()
    assert seen.off[-1].min() > 20 > seen.off[0].max()


def test_a_replay_is_caught_as_a_guess_is() -> None:
    undetected = spoofed(Replay(None, {"length": 3}, rng()), 12, runs=4000, honest=8).undetected
    assert undetected[0] < 0.3
    assert undetected[-1] == 0


def test_covert_is_never_seen_by_the_controller() -> None:
    seen = rewritten(Covert(model(), {"input": 0.3}, rng()), 59)
    assert not seen.alarms.any()
    assert seen.off[-1].min() > 4


def test_covert_stays_in_U_and_follows_a_step_that_was_missed() -> None:
    covert = Covert(model(), {"input": (0.5,)}, rng())
    edge = np.array([[5.8], [1.0]])
    assert np.allclose(covert.toward_plant(3, edge), edge + 0.2)
    x, yes = np.zeros(2), np.array(True)
    assert np.allclose(covert.toward_controller(4, x, yes), -0.2 * B[:, 0])
    first = covert.toward_controller(4, x, yes)
    covert.toward_plant(4, edge)
    missed = covert.toward_controller(5, x, np.array(False))
    assert np.allclose(missed, model().A @ first)


@pytest.mark.parametrize("holds", [False, True])
def test_covert_gives_no_tested_step_away_where_some_are_missed(holds: bool) -> None:
    covert, chance = Covert(model(), {"input": 0.3}, rng()), np.random.default_rng(4)
    x = np.array([4.0, -2.0])
    shown, in_force, off, tested = x, np.zeros(1), 0.0, 0
    for k in range(200):
        u = np.clip(-0.3 * shown[:1] - 0.5 * shown[1:], -5, 5)
        offered = covert.toward_plant(k, u[None])
        applied = chance.random() < 0.7
        in_force = offered[0] if applied else in_force * holds
        d = chance.uniform(-WIDTHS, WIDTHS)
        x = A @ x + B @ in_force + d
        after = covert.toward_controller(k + 1, x, np.array(applied))
        if applied:
            tested += 1
            assert np.allclose(after - A @ shown - B @ u, d)
        shown, off = after, np.abs(x - after).max()
    assert tested > 100
    assert off > 1


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
    ("kind", "known", "options", "line"),
    [
        ("ghost", None, NONE, "attack.knows: ghost needs 'model'"),
        ("bias", model(), {"sees": 0.1}, "attack.sees: got 0.1, "),
        ("ghost", model(), {"share": 2}, "attack.share: got 2, "),
        ("ghost", model(), {"share": 0.2}, "attack.push: ghost: expected at most 1 together"),
        ("ghost", model(), {"direction": [1]}, "attack.direction: got [1.0], expected 2 numbers"),
        ("replay", None, {"share": 2}, "attack.share: got 2, "),
        ("covert", model(), {"input": (1.0, 2.0)}, "attack.input: got [1.0, 2.0], expected 1"),
    ],
)
def test_what_does_not_fit_is_one_line(
    kind: str, known: Any, options: dict[str, Any], line: str
) -> None:
    with pytest.raises(AttackError) as caught:
        named(kind)(known, options, rng())
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)
