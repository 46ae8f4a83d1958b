"""Under any disturbance and noise that the sets allow, the applied candidate explains the reading.

Both stand at corners of D_c and N: there rounding alone decides whether a reading is explained.
"""

import random
from collections.abc import Sequence

import pytest

from protocol.agreement import predict
from protocol.box_observer import BoxObserver
from protocol.vectors import Vector


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
