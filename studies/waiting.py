"""What she resolves who waits some readings before she names a symbol, where outputs are read.

The loop is the shipped scenario `encoder`'s under u = K x_hat, with two candidates about half a
volt apart. Two rules say when a symbol that the defender decoded is secret: her own box of the
state, in D_e, finds both candidates possible after one reading; or the offer has both within
(alpha - 1) D_c. She then does the best that a set can: a linear program for each way on from the
other candidate. A symbol is resolved where none of them explains the readings that followed.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, Final

import numpy as np

from protocol.agreement import Gauge, predict, spread
from protocol.box_observer import Box, BoxObserver
from protocol.scenario import Scenario
from protocol.vectors import Vector
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.registry import study
from wyner.simulate.engine import simulate_runs

ALPHAS: Final = (1.2, 1.7, 2.5, 4.0, 12.0)
STEPS, SEED, WAITS = 160, 5, 4
OFFSET: Final = 0.46
"""Volts between the candidates: enough for the defender."""

SETTLING: Final = 10
"""First steps, which are not looked at."""

COLUMNS: Final = (
    "alpha offset steps seed waits within one_step_secret one_step_resolved offer_secret "
    "offer_resolved"
)

Offer = tuple[Vector, ...]


class _Offers:
    """u = K x_hat, with two candidates about half a volt apart."""

    def __init__(self, K: Vector) -> None:
        self._K = K

    def candidates(self, x: Vector, /) -> Offer:
        """Around the feedback's, within five volts."""
        middle = min(max(sum(k * v for k, v in zip(self._K, x, strict=True)), -5.0), 5.0)
        return ((middle - OFFSET / 2,), (middle + OFFSET / 2,))


@study("waiting", COLUMNS, lambda: ALPHAS)
def waiting_rows(alpha: float) -> Iterator[tuple[Any, ...]]:
    """The row of an alpha."""
    scenario = load_scenario(SCENARIOS / "encoder.toml")
    observer, K = scenario.observer, scenario.control.gain
    assert observer is not None
    assert K is not None
    gauge = Gauge.from_rows(*scenario.defender.disturbance.rows())
    widths = tuple(alpha * w for w in observer.disturbance)
    hers = BoxObserver(observer.A, observer.B, observer.C, widths, observer.noise, observer.bounds)
    found = list(_symbols(scenario, hers, _Offers(K[0])))
    one_step = [resolved for both, resolved in found if both]
    pushes = [predict(observer.A, observer.B, (0.0, 0.0), (s * OFFSET / 2,)) for s in (-1, 1)]
    within = 1.0 + spread(gauge, pushes) <= alpha
    offered = [resolved for _, resolved in found] if within else []
    yield (
        alpha, OFFSET, STEPS, SEED, WAITS, int(within), len(one_step), sum(one_step),
        len(offered), sum(offered),
    )  # fmt: skip


def _symbols(scenario: Scenario, hers: BoxObserver, law: _Offers) -> Iterator[tuple[bool, bool]]:
    """Of each symbol that the defender decoded: both possible in her box; resolved later."""
    runs = simulate_runs(scenario, law, seed=SEED, runs=range(1), steps=STEPS, record=True)
    assert runs.x is not None
    assert runs.candidates is not None
    readings = [tuple(y) for y in runs.x[:, :, 0].tolist()]
    offers = [tuple(map(tuple, offer)) for offer in runs.candidates[..., 0].tolist()]
    box = hers.begin(readings[0])
    boxes, both = [box], []
    for offer, y in zip(offers, readings[1:], strict=True):
        after = hers.step(box, offer, y)
        box = after.box
        boxes.append(box)
        both.append(len(after.possible) == 2)
    coins = runs.coin[:, 0].tolist()
    told = (runs.symbol[:, 0] == runs.coin[:, 0]).tolist()
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
