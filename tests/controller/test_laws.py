"""The laws: one state and many to the same bit, constraints, and the index that falls."""

import struct
from typing import Any

import numpy as np
import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import OutsideError, ProgramError
from controller_service.laws.registry import make_law
from controller_service.sets.design import Design, synthesise
from protocol.convex import Polytope, corners
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from tests.support.size import size

LAWS = ("paper", "sustained")


@pytest.fixture(scope="module")
def design() -> Design:
    return synthesise(scenario_of("paper"))


@pytest.fixture(scope="module", params=LAWS)
def law(request: pytest.FixtureRequest, design: Design) -> CandidateLaw:
    return make_law(scenario_of(request.param), design)


def states(design: Design, count: int, seed: int) -> np.ndarray:
    """States in the sets: some spread, some on edges and at corners of a set, or a bit off."""
    rng = np.random.default_rng(seed)
    near = rng.normal(size=(count // 2, 2)) * np.exp(rng.normal(size=(count // 2, 1)))
    pieces = [near, np.zeros((1, 2)), np.array([[-0.0, 0.0], [0.0, -0.0]])]
    while sum(map(len, pieces)) < count:
        V = corners(*design.set(int(rng.integers(0, 251))))
        weight = rng.choice([0.0, 0.5, 1.0, rng.uniform()], size=(len(V), 1))
        edge = V * weight + np.roll(V, 1, axis=0) * (1 - weight)
        pieces.append(edge * rng.choice([1 - 1e-9, 1 - 1e-15, 1.0, 0.5]))
    X = np.concatenate(pieces)[:count]
    H, h = design.set(250)
    return X[(h * (1 - 1e-10) > X @ H.T).all(axis=1)]


def bits(values: Any) -> bytes:
    return struct.pack(f"{len(values)}d", *values)


@pytest.mark.slow
def test_one_state_and_many_agree_to_the_last_bit(law: CandidateLaw, design: Design) -> None:
    X = states(design, size(30_000, 100_000), 1)
    assert len(X) > size(27_000, 90_000)
    index = law.indices(X)
    C = law.candidates_many(X, index)
    assert [law.index(x) for x in X.tolist()] == index.tolist()
    for x, c in zip(X.tolist(), C[:, :, 0].tolist(), strict=True):
        one = [u for (u,) in law.candidates(x)]
        assert bits(one) == bits(c), x


def test_answers_satisfy_the_constraints_and_are_optimal(law: CandidateLaw, design: Design) -> None:
    X = states(design, 4000, 2)
    X = X[np.abs(X).max(axis=1) < 1e5]
    index = law.indices(X)
    C = law.candidates_many(X, index)[:, :, 0]
    B = design.B[:, 0]
    paper = law.gain(0) is not None
    for x, i, c in zip(X, index, C, strict=True):
        if paper and i == 0:
            assert c == pytest.approx([design.K[0] @ x] * 2, rel=1e-12)
            continue
        H, h = design.target(max(int(i) - 1, 0))
        assert (np.abs(c) <= 6).all()
        free = design.A @ x
        g = H @ B
        room = h - H @ free
        high = min(6.0, (room[g > 1e-12] / g[g > 1e-12]).min())
        low = max(-6.0, (room[g < -1e-12] / g[g < -1e-12]).max())
        best = [-(B @ free) / (B @ B), 0.0]
        for u, wanted in zip(c, best, strict=True):
            assert Polytope(H, h).excess(free + B * u) <= 1e-9
            assert u == pytest.approx(min(max(wanted, low), high), abs=2e-5)


def test_the_index_is_the_smallest(law: CandidateLaw, design: Design) -> None:
    X = states(design, 600, 3)
    for x, i in zip(X, law.indices(X), strict=True):
        H, h = design.set(int(i))
        tolerance = 1e-14 * np.abs(x).max() + 1e-15
        assert (H @ x <= h + tolerance).all()
        if i > 0:
            H, h = design.set(int(i) - 1)
            assert (H @ x > h - tolerance).any()


def test_outside_says_by_how_much(law: CandidateLaw) -> None:
    with pytest.raises(OutsideError, match=r"\[1000000000.0, 0.0\] is outside T_250") as caught:
        law.candidates((1e9, 0.0))
    assert "beyond a facet" in str(caught.value)
    with pytest.raises(OutsideError):
        law.indices([[0.0, 0.0], [1e9, 0.0]])
    with pytest.raises(OutsideError):
        law.candidates((float("nan"), 0.0))
    with pytest.raises(OutsideError):
        law.indices([[float("nan"), 0.0]])


def test_a_cost_without_a_unique_minimiser_is_refused(design: Design) -> None:
    data = scenario_of("paper").model_dump(exclude_none=True)
    data["control"]["costs"] = ({"next_state": 1.0}, {})
    with pytest.raises(ProgramError, match=r"control\.costs\.1"):
        make_law(Scenario.model_validate(data), design)
