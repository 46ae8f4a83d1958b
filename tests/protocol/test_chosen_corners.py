"""Under any disturbance and noise that the sets allow, the applied candidate explains the reading.

The disturbance and the noise stand at corners of D_c and N, chosen in four ways: there rounding
alone decides whether a reading is explained.

    python -m tests.protocol.test_chosen_corners 100000     # steps a shipped scenario
"""

import random
import sys
from collections.abc import Callable, Sequence
from typing import Final

import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import INSIDE, predict
from protocol.box_observer import BoxObserver
from protocol.link.session import rules_of
from protocol.vectors import Vector
from runtime.scenario_file import scenario_of
from runtime.shipped import SCENARIOS

CHOICES: Final = ("constant", "periodic", "rare", "random")


def chosen(choice: str, draw: random.Random, widths: Sequence[float]) -> Callable[[int], Vector]:
    """A corner of the box a step: always one, turned in a rhythm, seldom, or drawn anew."""
    signs = [draw.choice((-1, 1)) for _ in widths]
    period, share = draw.randrange(1, 12), draw.choice((0.02, 0.1, 0.5))

    def corner(k: int) -> Vector:
        for i in range(len(signs)):
            turned = {
                "constant": False,
                "periodic": k % period == i % period,
                "rare": draw.random() < share,
                "random": draw.random() < 0.5,
            }[choice]
            signs[i] = -signs[i] if turned else signs[i]
        return tuple(s * w for s, w in zip(signs, widths, strict=True))

    return corner


def added(x: Vector, other: Vector) -> Vector:
    return tuple(a + b for a, b in zip(x, other, strict=True))


def random_observer(draw: random.Random) -> BoxObserver:
    """A stable plant of one to three states, with widths from 1e-9 to 0.1."""
    n, m = draw.randrange(1, 4), draw.randrange(1, 3)
    r = draw.randrange(1, n + 1)

    def beside() -> float:
        return draw.choice((0.0, draw.uniform(-1, 1)))

    return BoxObserver(
        A=tuple(
            tuple(draw.uniform(-0.9, 0.9) if i == j else 0.3 * beside() for j in range(n))
            for i in range(n)
        ),
        B=tuple(tuple(draw.uniform(-1, 1) for _ in range(m)) for _ in range(n)),
        C=tuple(
            tuple(draw.uniform(0.2, 1) if i == j else beside() for j in range(n)) for i in range(r)
        ),
        disturbance=tuple(10 ** draw.uniform(-9, -1) for _ in range(n)),
        noise=tuple(10 ** draw.uniform(-9, -1) for _ in range(r)),
        bounds=(50.0,) * n,
    )


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-3, 1.0])
def test_a_box_never_loses_the_state_nor_the_applied_candidate(size: float) -> None:
    """Where states are far smaller than the noise a reading's own rounding is the larger number."""
    for seed in range(40):
        draw = random.Random(seed)
        observer = random_observer(draw)
        n, m = len(observer.A), len(observer.B[0])
        disturbance = chosen("random", draw, observer.disturbance)
        noise = chosen("random", draw, observer.noise)
        x = tuple(size * draw.uniform(-1, 1) for _ in range(n))
        box = observer.begin(added(observer.read(x), noise(0)))
        for k in range(40):
            assert all(a <= v <= b for a, v, b in zip(box.low, x, box.high, strict=True)), seed
            candidates = [tuple(size * draw.uniform(-1, 1) for _ in range(m)) for _ in range(2)]
            coin = draw.randrange(2)
            x = added(predict(observer.A, observer.B, x, candidates[coin]), disturbance(k))
            found = observer.step(box, candidates, added(observer.read(x), noise(k + 1)))
            assert coin in found.possible, seed
            box = found.box


def excluded(name: str, choice: str, steps: int, seed: int) -> int:
    """How often the applied candidate is excluded, in a loop of a shipped scenario's own law."""
    scenario = scenario_of(name)
    law, rules = make_law(scenario, cached_design(scenario)), rules_of(scenario)
    draw = random.Random(seed)
    D_c, N = scenario.defender.disturbance.half_widths, scenario.defender.noise
    assert D_c is not None
    assert N is not None
    assert N.half_widths is not None
    disturbance, noise = chosen(choice, draw, D_c), chosen(choice, draw, N.half_widths)
    outputs, agreement = rules.outputs, rules.agreement
    x: Vector = scenario.initial_state

    def reading(k: int) -> Vector:
        return added(x if outputs is None else outputs.observer.read(x), noise(k))

    y, lost = reading(0), 0
    box = None if outputs is None else outputs.box(None, 0, y)
    for k in range(steps):
        candidates = law.candidates(y if box is None else box.centre)
        coin = draw.randrange(len(candidates))
        x = added(predict(scenario.A, scenario.B, x, candidates[coin]), disturbance(k))
        following = reading(k + 1)
        if outputs is None or box is None:
            verdict = agreement.verdict(y, candidates, following)
        else:
            verdict = outputs.judge(box, candidates, following)
            assert verdict.estimate is not None
            box = verdict.estimate.box
            lost += not all(a <= v <= b for a, v, b in zip(box.low, x, box.high, strict=True))
        lost += not verdict.gauges[coin] <= INSIDE
        y = following
    return lost


def noisy_scenarios() -> list[str]:
    """The shipped scenarios whose sensors are noisy or read outputs alone."""
    names = sorted(path.stem for path in SCENARIOS.glob("*.toml"))
    return [name for name in names if scenario_of(name).defender.noise is not None]


def test_each_noisy_scenario_is_looked_at() -> None:
    assert noisy_scenarios() == ["encoder", "noisy"]


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("name", ["encoder", "noisy"])
def test_a_shipped_loop_never_excludes_the_applied_candidate(name: str, choice: str) -> None:
    assert excluded(name, choice, 500, seed=1) == 0


if __name__ == "__main__":
    for scenario_name in noisy_scenarios():
        for how in CHOICES:
            count = int(sys.argv[1]) // len(CHOICES)
            found = excluded(scenario_name, how, count, seed=7)
            print(f"{scenario_name}, {how} corners: {found} of {count} steps lost the truth")
