"""What she resolves who waits some readings before she names a symbol, where outputs are read.

The loop is the shipped scenario `encoder`'s under u = K x_hat, with two candidates about half a
volt apart. Two rules say when a symbol that the defender decoded is secret: her own box of the
state, in D_e, finds both candidates possible after one reading; or the offer has both within
(alpha - 1) D_c. She then does the best that a set can: a linear program for each way on from the
other candidate. A symbol is resolved where none of them explains the readings that followed.
"""

import random
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, Final

import numpy as np

from protocol.agreement import Gauge, predict, spread
from protocol.box_observer import Box, BoxObserver
from protocol.vectors import Vector
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS

ALPHAS: Final = (1.2, 1.7, 2.5, 4.0, 12.0)
STEPS, SEED, WAITS = 160, 5, 4
OFFSET: Final = 0.46
"""Volts between the candidates: enough for the defender."""

SETTLING: Final = 10
"""First steps, which are not looked at."""

COLUMNS: Final = (
    "alpha",
    "offset",
    "steps",
    "seed",
    "waits",
    "within",
    "one_step_secret",
    "one_step_resolved",
    "offer_secret",
    "offer_resolved",
)

Offer = tuple[Vector, ...]


def waiting_rows() -> Iterator[tuple[Any, ...]]:
    """One row an alpha."""
    scenario = load_scenario(SCENARIOS / "encoder.toml")
    observer, K = scenario.observer, scenario.control.gain
    assert observer is not None
    assert K is not None
    gauge = Gauge.from_rows(*scenario.defender.disturbance.rows())
    for alpha in ALPHAS:
        hers = BoxObserver(
            observer.A,
            observer.B,
            observer.C,
            tuple(alpha * w for w in observer.disturbance),
            observer.noise,
            observer.bounds,
        )
        found = list(_symbols(observer, hers, K[0], scenario.initial_state))
        one_step = [resolved for both, resolved in found if both]
        pushes = [predict(observer.A, observer.B, (0.0, 0.0), (s * OFFSET / 2,)) for s in (-1, 1)]
        within = 1.0 + spread(gauge, pushes) <= alpha
        offered = [resolved for _, resolved in found] if within else []
        yield (
            alpha,
            OFFSET,
            STEPS,
            SEED,
            WAITS,
            int(within),
            len(one_step),
            sum(one_step),
            len(offered),
            sum(offered),
        )


def _symbols(
    observer: BoxObserver, hers: BoxObserver, K: Vector, x: Vector
) -> Iterator[tuple[bool, bool]]:
    """Of each symbol that the defender decoded: both possible in her box; resolved later."""
    draw = random.Random(SEED)

    def read(x: Vector) -> Vector:
        noise = (draw.uniform(-w, w) for w in observer.noise)
        return tuple(v + n for v, n in zip(observer.read(x), noise, strict=True))

    y = read(x)
    box, her_box = observer.begin(y), hers.begin(y)
    offers: list[Offer] = []
    readings, boxes, coins, told, both = [y], [her_box], [], [], []
    for _ in range(STEPS):
        centre = sum(k * v for k, v in zip(K, box.centre, strict=True))
        middle = min(max(centre, -5.0), 5.0) if box.radius[1] < 1 else 0.0
        offer = ((middle - OFFSET / 2,), (middle + OFFSET / 2,))
        coin = draw.randrange(2)
        d = [draw.uniform(-w, w) for w in observer.disturbance]
        moved = predict(observer.A, observer.B, x, offer[coin])
        x = tuple(a + b for a, b in zip(moved, d, strict=True))
        y = read(x)
        after, her_after = observer.step(box, offer, y), hers.step(her_box, offer, y)
        box, her_box = after.box, her_after.box
        offers.append(offer)
        coins.append(coin)
        readings.append(y)
        boxes.append(her_box)
        told.append(after.possible == (coin,))
        both.append(len(her_after.possible) == 2)
    for k in range(SETTLING, STEPS - WAITS):
        if told[k]:
            window = slice(k, k + WAITS + 1)
            later = readings[k + 1 : k + WAITS + 2]
            other = 1 - coins[k]
            yield both[k], not _explained(hers, boxes[k], offers[window], later, other)


def _explained(
    hers: BoxObserver, box: Box, offers: Sequence[Offer], readings: Sequence[Vector], first: int
) -> bool:
    """Whether any way on from candidate ``first`` leads to these readings, for x in the box."""
    from scipy.optimize import linprog

    A, B, C = np.array(hers.A), np.array(hers.B), np.array(hers.C)
    n, count = len(A), len(offers)
    # unknowns: x(k), then d of each step; reading i is C (A^i x + sum A^(i-1-j) (B u_j + d_j))
    powers = [np.linalg.matrix_power(A, i) for i in range(count + 1)]
    rows = np.zeros((count * len(C), n * (1 + count)))
    for i in range(1, count + 1):
        at = slice((i - 1) * len(C), i * len(C))
        rows[at, :n] = C @ powers[i]
        for j in range(i):
            rows[at, n * (1 + j) : n * (2 + j)] = C @ powers[i - 1 - j]
    D = [(-w, w) for w in hers.disturbance]
    bounds = [*zip(box.low, box.high, strict=True), *(D * count)]
    wide = np.tile(np.array(hers.noise), count)
    for rest in product(range(2), repeat=count - 1):
        chosen = [offer[c] for offer, c in zip(offers, (first, *rest), strict=True)]
        x, pushed = np.zeros(n), []
        for u in chosen:
            x = A @ x + B @ np.array(u)
            pushed.append(C @ x)
        left = (np.array(readings) - np.array(pushed)).ravel()
        found = linprog(
            np.zeros(rows.shape[1]),
            A_ub=np.vstack([rows, -rows]),
            b_ub=np.concatenate([left + wide, wide - left]),
            bounds=bounds,
        )
        if found.status == 0:
            return True
    return False
