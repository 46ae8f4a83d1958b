"""The authors' published example of their controller, computed twice: by corners here, and by us.

Their program (PreCyseGroup/ST-MPC, main.m) is MATLAB. What it does is written here anew with
SciPy's half-planes and hulls, which share no code with the synthesis.
"""

from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.spatial import ConvexHull, HalfspaceIntersection

from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.terminal import feedback_gain
from protocol.arrays import Array
from runtime.scenario_file import scenario_of
from tests.support.scenarios import changed

A: Final = np.array([[1.0, 0.0975], [0.0, 0.95]])
B: Final = np.array([0.0246, 0.4877])
W: Final = np.array([[a, b] for a in (-0.03, 0.03) for b in (-0.05, 0.05)])
BOUNDS: Final = np.array([[1, 0, -2], [-1, 0, -2], [0, 1, -5], [0, -1, -5]], dtype=float)
U: Final = (-1.1, 1.2)
STEPS, SETS, RPI_ALPHA = 30, 25, 0.001
X0: Final = (-0.15, 4.9)


def rows_of(corners: Array) -> Array:
    """Half-planes (a_1, a_2, -b) of the hull of some points."""
    return np.unique(np.round(ConvexHull(corners).equations, 12), axis=0)


def corners_of(rows: Array) -> Array:
    """Corners of an intersection of half-planes around the origin."""
    return HalfspaceIntersection(rows, np.zeros(2)).intersections


def sum_of(P: Array, Q: Array) -> Array:
    """Corners of a Minkowski sum."""
    points = (P[:, None] + Q[None]).reshape(-1, 2)
    return points[ConvexHull(points).vertices]


def eroded(rows: Array) -> Array:
    """Half-planes of the Minkowski difference with W."""
    return np.column_stack([rows[:, :2], rows[:, 2] + (W @ rows[:, :2].T).max(axis=0)])


class Theirs(NamedTuple):
    """Their gain, the terms of T_0, and the half-planes of T_0, T_1, ..."""

    K: Array
    terms: int
    sets: list[Array]


@pytest.fixture(scope="module")
def theirs() -> Theirs:
    P = solve_discrete_are(A, B[:, None], np.diag([100.0, 1.0]), np.eye(1))
    K = -(B @ P @ A) / (1.0 + B @ P @ B)
    closed, power, terms, total = A + np.outer(B, K), np.eye(2), 0, np.zeros((1, 2))
    while True:
        total = sum_of(total, W @ power.T) if terms else W
        power, terms = closed @ power, terms + 1
        if (np.abs(W @ power.T).max(axis=0) <= RPI_ALPHA * W.max(axis=0)).all():
            break
    rows = rows_of(total / (1 - RPI_ALPHA))
    sets = [rows]
    moved = np.outer(-np.array(U), B)
    for _ in range(SETS):
        grown = rows_of(sum_of(corners_of(eroded(rows)), moved))
        back = np.column_stack([grown[:, :2] @ A, grown[:, 2]])
        rows = rows_of(corners_of(np.concatenate([back, BOUNDS])))
        sets.append(rows)
    return Theirs(K, terms, sets)


def area(rows: Array) -> float:
    """Of the set within some half-planes."""
    return float(ConvexHull(corners_of(rows)).volume)


def index(sets: list[Array], x: Array) -> int:
    """The first set that holds x."""
    return next(i for i, rows in enumerate(sets) if (rows[:, :2] @ x + rows[:, 2] <= 1e-9).all())


def input_of(theirs: Theirs, x: Array, i: int) -> float:
    """K x in T_0; else the minimiser of |A x + B u|^2 within U that leads into T_(i-1) ~ W."""
    if i == 0:
        return float(theirs.K @ x)
    rows = eroded(theirs.sets[i - 1])
    slopes, rest = rows[:, :2] @ B, -rows[:, 2] - rows[:, :2] @ A @ x
    low = max([U[0], *(rest[slopes < 0] / slopes[slopes < 0])])
    high = min([U[1], *(rest[slopes > 0] / slopes[slopes > 0])])
    return float(np.clip(-(B @ A @ x) / (B @ B), low, high))


def test_gain_and_sets_are_the_authors(theirs: Theirs) -> None:
    design = cached_design(scenario_of("st-mpc"))
    assert theirs.K.tolist() == pytest.approx([-5.9075, -1.5610], abs=5e-5)
    assert design.K[0] == pytest.approx(theirs.K, abs=1e-9)
    assert theirs.terms == design.terminal.order == 15
    ours = [np.column_stack([H, -h]) for H, h in design.T]
    # Theirs counts T_0 larger by 1 / (1 - 0.001), ours by what the fifteenth power needs.
    assert [area(rows) for rows in ours] == pytest.approx(
        [area(rows) for rows in theirs.sets[: len(ours)]], rel=1e-3
    )
    # Beyond ours theirs do not grow: their program compares sets to see that, and so does ours.
    assert area(theirs.sets[-1]) == pytest.approx(area(ours[-1]), rel=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_the_closed_loop_goes_where_theirs_does(theirs: Theirs, seed: int) -> None:
    """The same W draws through both: the same inputs, an index that falls, inputs within U."""
    scenario = scenario_of("st-mpc")
    law = make_law(scenario, cached_design(scenario))
    rng = np.random.default_rng(seed)
    x = y = np.array(X0)
    indices, inputs = [], []
    for d in rng.uniform(W.min(axis=0), W.max(axis=0), (STEPS, 2)):
        i = law.index(tuple(x.tolist()))
        indices.append(i)
        u = law.candidates(tuple(x.tolist()))[0][0]
        v = input_of(theirs, y, index(theirs.sets, y))
        inputs.append(u - v)
        assert U[0] - 1e-9 <= u <= U[1] + 1e-9
        x, y = A @ x + B * u + d, A @ y + B * v + d
    assert all(b <= max(a - 1, 0) for a, b in pairwise(indices))
    assert indices[-1] == 0
    # T_0 differs by less than a thousandth, so an input on its edge does.
    assert np.abs(inputs).max() < 2e-3
    assert np.abs(x - y).max() < 2e-3


def test_the_papers_gain_is_a_regulators() -> None:
    """Equation (25), K = (-13.27, -2.26), is that of Q = diag(1000, 1), R = 1, as MPT3 has it."""
    weights = {"next_state": [1000.0, 1.0], "input": [1.0]}
    K = feedback_gain(changed("paper", control={"gain": None, "regulator": weights}))
    assert K[0] == pytest.approx([-13.2708, -2.2641], abs=5e-5)
    printed = scenario_of("paper").control.gain
    assert printed is not None
    assert np.abs(K[0] - printed[0]).max() < 0.005  # to the two digits that the paper prints
