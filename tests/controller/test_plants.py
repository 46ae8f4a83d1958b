"""Plants of one to four states and one or two inputs: sets, constraints, and the index that falls.

Each plant is tried in a stable and in an unstable form, some with polytopes that are no boxes.
"""

from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law
from controller_service.sets.design import Design, set_corners, synthesise
from protocol.convex import Polytope, corners
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from tests.support.size import size

HEXAGON = [[1.0, 0.0], [0.5, 0.8], [-0.6, 0.9], [-1.0, -0.1], [-0.4, -1.0], [0.7, -0.8]]
OCTAHEDRON = [list(signs) for signs in product((1.0, -1.0), repeat=3)]

A1 = {"stable": [[0.8]], "unstable": [[-1.2]]}
A2 = {"stable": [[0.9, 0.2], [-0.1, 0.8]], "unstable": [[1.15, 0.3], [0.0, 0.9]]}
A3 = {
    "stable": [[0.9, 0.2, 0.0], [0.0, 0.8, 0.2], [0.0, 0.0, 0.7]],
    "unstable": [[1.1, 0.2, 0.0], [0.0, 0.9, 0.2], [0.0, 0.0, 0.7]],
}
A4 = {
    "stable": [[0.9, 0.2, 0, 0], [0, 0.8, 0.2, 0], [0, 0, 0.7, 0.1], [0, 0, 0, 0.6]],
    "unstable": [[1.05, 0.2, 0, 0], [0, 0.9, 0.2, 0], [0, 0, 0.7, 0.1], [0, 0, 0, 0.6]],
}
B = {
    (1, 1): [[0.5]],
    (1, 2): [[0.5, -0.3]],
    (2, 1): [[0.1], [0.5]],
    (2, 2): [[0.4, 0.1], [0.0, 0.5]],
    (3, 1): [[0.1], [0.2], [0.5]],
    (3, 2): [[0.4, 0.0], [0.0, 0.2], [0.1, 0.5]],
    (4, 1): [[0.2], [0.2], [0.3], [0.5]],
    (4, 2): [[0.4, 0.0], [0.0, 0.2], [0.1, 0.3], [0.0, 0.5]],
}


def plant(n: int, m: int, kind: str, horizon: int, **tables: Any) -> Scenario:
    """A small plant; ``tables`` replace D_c, U and other entries of the control table."""
    disturbance = tables.pop("disturbance", {"half_widths": [0.02] * n})
    return Scenario.model_validate(
        {
            "name": f"{kind}-{n}-{m}",
            "plant": {
                "A": {1: A1, 2: A2, 3: A3, 4: A4}[n][kind],
                "B": B[n, m],
                "period_s": 0.1,
                "initial_state": [0.0] * n,
                "disturbance": {"half_widths": [0.001] * n},
            },
            "defender": {"disturbance": disturbance},
            "control": {
                "horizon": horizon,
                "inputs": {"half_widths": [1.0] * m},
                "regulator": {"next_state": [1.0] * n, "input": [1.0] * m},
                "costs": [{"next_state": 1.0, "input": 0.01}, {"input": 1.0}],
                **tables,
            },
            "secrecy": {"alpha": 4.0},
        }
    )


def spread(design: Design, count: int, seed: int) -> np.ndarray:
    """States in the sets: on edges of some T_i, between its corners, and at the origin."""
    rng = np.random.default_rng(seed)
    pieces = [np.zeros((1, len(design.A))), -np.zeros((1, len(design.A)))]
    for i in (0, design.horizon, *rng.integers(0, design.horizon + 1, 8)):
        V = corners(*design.set(int(i)))
        few = V[rng.integers(0, len(V), (count // 10, 2))]
        weight = rng.choice([0.0, 1.0, 0.5, 0.3], size=(count // 10, 1))
        shrink = rng.choice([1 - 1e-9, 1 - 1e-12, 0.7], size=(count // 10, 1))
        pieces.append((few[:, 0] * weight + few[:, 1] * (1 - weight)) * shrink)
    X = np.concatenate(pieces)
    H, h = design.set(design.horizon)
    return X[(h >= X @ H.T).all(axis=1)]


def check_loop(scenario: Scenario, design: Design, law: CandidateLaw, steps: int) -> None:
    """Adversarial steps from the sets' edges: the constraints hold and the index falls."""
    rng = np.random.default_rng(7)
    D = set_corners(scenario.defender.disturbance)
    admissible = rules_of(scenario).admissible
    U = Polytope.from_rows(*scenario.control.inputs.rows())
    start = spread(design, max(40, steps // 12), 8)
    X, index = start, law.indices(start)
    assert {0, design.horizon} <= set(index.tolist())
    done = 0
    while done < steps:
        C = law.candidates_many(X, index)
        for candidate in range(C.shape[1]):
            u = C[:, candidate]
            assert (u @ U.H.T <= U.h + 1e-9).all()
            assert all(map(admissible, u[:100].tolist()))  # as the plant sees it
            centre = X @ design.A.T + u @ design.B.T
            for i in np.unique(index):
                H, h = design.target(max(int(i) - 1, 0))
                assert (centre[index == i] @ H.T <= h + 1e-9).all()
        u = C[np.arange(len(X)), rng.integers(0, C.shape[1], len(X))]
        X = X @ design.A.T + u @ design.B.T + D[rng.integers(0, len(D), len(X))]
        after = law.indices(X)
        assert (after <= np.maximum(index - 1, 0)).all()
        done += len(X)
        # A state that has been in T_0 for long says little: begin again at the edges.
        X, index = (X, after) if after.any() else (start, law.indices(start))


CASES: list[tuple[int, int, int, dict[str, Any]]] = [
    (1, 1, 30, {}),
    (1, 2, 30, {}),
    (2, 2, 20, {}),
    (3, 1, 5, {}),
    (3, 2, 4, {}),
    (4, 1, 4, {}),
    (4, 2, 3, {}),
    (1, 1, 30, {"inputs": {"H": [[2.0], [-1.0]], "h": [1.0, 1.5]}}),
    (2, 1, 20, {"disturbance": {"H": HEXAGON, "h": [0.02] * 6}}),
    (2, 2, 15, {"inputs": {"H": HEXAGON, "h": [0.8] * 6}}),
    (3, 1, 5, {"disturbance": {"H": OCTAHEDRON, "h": [0.03] * 8}}),
    (3, 2, 3, {"inputs": {"H": HEXAGON, "h": [0.8] * 6}}),
    (4, 2, 2, {"inputs": {"H": HEXAGON, "h": [0.8] * 6}}),
]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["stable", "unstable"])
@pytest.mark.parametrize(
    ("n", "m", "horizon", "tables"),
    [pytest.param(*case, marks=[pytest.mark.slow] * (case[0] > 3)) for case in CASES],
)
def test_constraints_hold_and_the_index_falls(
    n: int, m: int, horizon: int, tables: dict[str, Any], kind: str
) -> None:
    scenario = plant(n, m, kind, horizon, **tables)
    design = synthesise(scenario)
    check_loop(scenario, design, make_law(scenario, design), size(3_000, 10_000))


def test_a_target_much_thinner_than_its_set() -> None:
    """T_0 ~ D_c is a hundredth of T_0: rounding in A x + B u counts against the thin one."""
    scenario = scenario_of("double-integrator")
    design = synthesise(scenario)
    (_, h), (_, g) = design.set(0), design.target(0)
    assert g.min() < 0.02 * h.min()
    check_loop(scenario, design, make_law(scenario, design), 200_000)
    data = plant(1, 1, "unstable", 20, disturbance={"half_widths": [0.2]}).model_dump(
        exclude_none=True
    )
    del data["control"]["regulator"]
    data["control"]["gain"] = [[2.400002]]  # A + B K is 1e-6
    scenario = Scenario.model_validate(data)
    design = synthesise(scenario)
    assert design.target(0)[1].min() < 1e-3 * design.set(0)[1].min()
    check_loop(scenario, design, make_law(scenario, design), 200_000)


@pytest.mark.parametrize("factor", [1e-7, 1e7])
@pytest.mark.parametrize(("n", "m", "horizon"), [(1, 2, 10), (2, 1, 10), (2, 2, 10), (3, 2, 3)])
def test_the_unit_of_the_state_does_not_matter(n: int, m: int, horizon: int, factor: float) -> None:
    data = plant(n, m, "unstable", horizon).model_dump(exclude_none=True)
    data["plant"]["B"] = np.multiply(data["plant"]["B"], factor).tolist()
    data["plant"]["disturbance"]["half_widths"] = [0.0] * n
    data["defender"]["disturbance"] = {"half_widths": [0.02 * factor] * n}
    data["control"]["regulator"]["input"] = [factor**2] * m
    data["control"]["costs"][0]["input"] = 0.01 * factor**2
    scenario = Scenario.model_validate(data)
    design = synthesise(scenario)
    check_loop(scenario, design, make_law(scenario, design), 1000)
    plain = synthesise(plant(n, m, "unstable", horizon))
    H, h = design.set(design.horizon)
    V = corners(*plain.set(design.horizon)) * factor
    assert (V @ H.T).max(axis=0) / h == pytest.approx(np.ones(len(h)), rel=1e-5)


def exact_interval(low: Fraction, high: Fraction, a: Fraction) -> tuple[Fraction, Fraction]:
    """The values x with a x between the two."""
    ends = sorted((low / a, high / a))
    return ends[0], ends[1]


@pytest.mark.parametrize("kind", ["stable", "unstable"])
@pytest.mark.parametrize("m", [1, 2])
def test_intervals_are_the_exact_ones_and_no_larger(m: int, kind: str) -> None:
    """The recursion on rational numbers: nothing of it is shared with the synthesis."""
    tables: dict[str, Any] = {"disturbance": {"H": [[1.0], [-4.0]], "h": [0.02, 0.04]}}
    if m == 1:
        tables["inputs"] = {"H": [[2.0], [-1.0]], "h": [1.0, 1.5]}
    scenario = plant(1, m, kind, 25, **tables)
    design = synthesise(scenario)
    a, B = Fraction(scenario.A[0][0]), [Fraction(b) for b in scenario.B[0]]
    d = (Fraction(-0.04) / 4, Fraction(0.02))
    u = (Fraction(-1.5), Fraction(0.5)) if m == 1 else (Fraction(-1), Fraction(1))
    push = (sum(min(b * v for v in u) for b in B), sum(max(b * v for v in u) for b in B))
    high, low = (Fraction(v) for v in design.set(0)[1].tolist())
    low = -low
    # T_0 holds the minimal invariant interval: A_c T_0 + D_c stays in it.
    ac = a + sum(b * Fraction(k) for b, (k,) in zip(B, design.K.tolist(), strict=True))
    reach = sorted((ac * low, ac * high))
    assert low < reach[0] + d[0]
    assert reach[1] + d[1] < high
    shrunk = 1e-11 if m == 1 else 1e-4
    for i in range(1, design.horizon + 1):
        low, high = exact_interval(low - d[0] - push[1], high - d[1] - push[0], a)
        above, below = design.set(i)[1].tolist()
        assert 1 - shrunk < Fraction(above) / high < 1
        assert 1 - shrunk < Fraction(below) / -low < 1


def test_sets_of_one_state_stop_growing_where_the_input_cannot_push_further() -> None:
    design = synthesise(plant(1, 1, "unstable", 1000))
    assert design.horizon < 200
    # The largest x with 1.2 x - 0.5 + 0.02 <= x.
    assert design.set(design.horizon)[1] == pytest.approx([2.4, 2.4], rel=1e-6)


@pytest.mark.parametrize("field", ["control.inputs", "control.disturbance", "defender.disturbance"])
def test_an_unbounded_set_is_refused_where_the_scenario_is_read(field: str) -> None:
    data = plant(1, 1, "stable", 5).model_dump(exclude_none=True)
    table, name = field.split(".")
    data[table][name] = {"H": [[1.0]], "h": [1.0]}
    with pytest.raises(ValidationError, match=f"{field}: the set is unbounded, expected a compact"):
        Scenario.model_validate(data)
