"""The box observer: it holds the state, is the same at both ends, and tells inputs apart."""

import random
from collections.abc import Sequence

import pytest

from protocol.agreement import predict
from protocol.box_observer import Box, BoxObserver
from protocol.vectors import Vector
from runtime.scenario_file import scenario_of

MOTOR = BoxObserver(
    A=((1.0, 0.0909), (0.0, 0.8187)),
    B=((0.0468,), (0.9063,)),
    C=((1.0, 0.0),),
    disturbance=(0.0005, 0.005),
    noise=(0.0005,),
    bounds=(10.0, 10.0),
)
"""A motor read by its encoder alone; the disturbance is a torque."""

PAPER = BoxObserver(
    A=((1.0, 0.0975), (0.0, 0.9512)),
    B=((0.0246,), (0.4877,)),
    C=((1.0, 0.0),),
    disturbance=(0.12, 0.12),
    noise=(0.001,),
    bounds=(20.0, 20.0),
)


def run(
    observer: BoxObserver, offset: float, steps: int, seed: int
) -> tuple[list[tuple[int, ...]], list[int], list[Box]]:
    """A loop of K x plus or minus half the offset, d and n at corners; the box holds x."""
    draw = random.Random(seed)
    x: tuple[float, ...] = (0.5, 0.0)

    def read(x: tuple[float, ...]) -> tuple[float, ...]:
        rows = zip(observer.C, observer.noise, strict=True)
        return tuple(
            sum(c * v for c, v in zip(row, x, strict=True)) + draw.choice((-w, w))
            for row, w in rows
        )

    box = observer.begin(read(x))
    possible, coins, boxes = [], [], []
    for _ in range(steps):
        middle = -2.0 * box.centre[0] - 0.5 * box.centre[1] if box.radius[1] < 5 else 0.0
        candidates = tuple((middle + sign * offset / 2,) for sign in (-1.0, 1.0))
        coin = draw.randrange(2)
        moved = predict(observer.A, observer.B, x, candidates[coin])
        d = [draw.choice((-w, w)) for w in observer.disturbance]
        x = tuple(a + b for a, b in zip(moved, d, strict=True))
        found = observer.step(box, candidates, read(x))
        box = found.box
        assert all(a <= v <= b for a, v, b in zip(box.low, x, box.high, strict=True))
        assert coin in found.possible
        possible.append(found.possible)
        coins.append(coin)
        boxes.append(box)
    return possible, coins, boxes


@pytest.mark.parametrize("seed", range(3))
def test_a_motor_by_its_encoder_carries_keys(seed: int) -> None:
    """1000 steps, every draw a corner: the coin is the one candidate in more than 90 %."""
    possible, coins, _ = run(MOTOR, 0.8, 1000, seed)
    told = [p == (coin,) for p, coin in zip(possible, coins, strict=True)]
    assert sum(told) > 900
    assert not any(len(p) == 1 and p[0] != c for p, c in zip(possible, coins, strict=True))


def test_the_papers_plant_does_not() -> None:
    """Its disturbance moves the position itself, further than an input does."""
    possible, _, boxes = run(PAPER, 0.8, 300, seed=1)
    assert sum(len(p) == 1 for p in possible) < 30
    moved, blur = PAPER.needed(boxes[-1], (0.8,))
    assert moved[0] < blur[0]
    _, _, small = run(MOTOR, 0.8, 300, seed=1)
    radius = sorted(b.radius[1] for b in small)[150]
    moved, blur = MOTOR.needed(Box((0.0, -radius), (0.0, radius)), (0.8,))
    assert moved[0] > 0.9 * blur[0]


def test_a_reading_that_nothing_explains_begins_anew() -> None:
    box = MOTOR.begin((0.0,))
    after = MOTOR.step(Box((0.0, 0.0), (0.0, 0.0)), ((0.0,), (0.5,)), (5.0,))
    assert after.possible == ()
    assert after.box == MOTOR.begin((5.0,))
    assert box.high[1] == 10.0
    missed = MOTOR.step(Box((0.0, 0.0), (0.0, 0.0)), ((0.0,),), (0.0,))
    assert missed.possible == (0,)


@pytest.mark.parametrize(
    ("name", "noise", "needed"), [("motor", 0.0005, 0.724), ("sustained", 0.001, 20.3)]
)
def test_how_far_apart_inputs_must_be_where_the_position_alone_is_read(
    name: str, noise: float, needed: float
) -> None:
    """The numbers of docs/concepts.md."""
    s = scenario_of(name)
    widths = s.defender.disturbance.half_widths
    assert widths is not None
    position = ((1.0, *(0.0,) * (s.n - 1)),)
    observer = BoxObserver(s.A, s.B, position, widths, (noise,), (1e6,) * s.n)
    radius = observer.quiet()
    box = Box(tuple(-r for r in radius), radius)
    moved, blur = observer.needed(box, (1.0,))
    apart = min(b / a for a, b in zip(moved, blur, strict=True) if a > 0)
    assert apart == pytest.approx(needed, rel=2e-3)


# --- observers drawn at random --------------------------------------------------------------------


def corner(draw: random.Random, widths: Sequence[float]) -> Vector:
    """A corner of the box."""
    return tuple(draw.choice((-w, w)) for w in widths)


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
        x = tuple(size * draw.uniform(-1, 1) for _ in range(n))
        box = observer.begin(added(observer.read(x), corner(draw, observer.noise)))
        for _ in range(40):
            assert all(a <= v <= b for a, v, b in zip(box.low, x, box.high, strict=True)), seed
            candidates = [tuple(size * draw.uniform(-1, 1) for _ in range(m)) for _ in range(2)]
            coin = draw.randrange(2)
            x = added(
                predict(observer.A, observer.B, x, candidates[coin]),
                corner(draw, observer.disturbance),
            )
            found = observer.step(
                box, candidates, added(observer.read(x), corner(draw, observer.noise))
            )
            assert coin in found.possible, seed
            box = found.box
