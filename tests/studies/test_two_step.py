"""Codes over two steps: each one found is checked point by point, apart from the search."""

import csv
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from studies.capacity.blocks import most_keys
from studies.capacity.clique import adjacency, largest_clique
from studies.capacity.two_step import TwoStepCode, best_codes
from wyner.sweeps.code import ROOT


def copies(code: TwoStepCode, shift: tuple[float, float], reach: int = 4) -> np.ndarray:
    """The key's points of the plane near the origin."""
    p, q = (np.array(v) for v in code.periods)
    i, j = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    near = np.array(shift) - sum(
        np.floor(t) * v
        for t, v in zip(np.linalg.solve(np.array([p, q]).T, shift), (p, q), strict=True)
    )
    out: np.ndarray = near + i.reshape(-1, 1) * p + j.reshape(-1, 1) * q
    return out


def check(code: TwoStepCode, alpha: float) -> None:
    """For d at random and at corners: the defender tells the key, she can rule out none."""
    rng = np.random.default_rng(code.keys)
    points = [copies(code, shift) for shift in code.shifts]
    for r, own in enumerate(points):
        centre = own[np.abs(own).max(axis=1).argmin()]
        d = rng.uniform(-1, 1, (400, 2))
        d[:4] = [(-1, -1), (-1, 1), (1, -1), (1, 1)]
        for s, other in enumerate(points):
            far = np.abs((centre + d)[:, None] - other[None]).max(axis=2).min(axis=1)
            assert (far <= alpha + 1e-9).all()
            if s != r:
                assert (far >= 1 - 1e-9).all()


@pytest.fixture(scope="module")
def found() -> dict[float, TwoStepCode]:
    alphas = [2.1, 7 / 3, 2.75]
    return dict(zip(alphas, best_codes(alphas), strict=True))


@pytest.mark.slow
def test_every_code_does_what_it_says(found: dict[float, TwoStepCode]) -> None:
    for alpha, code in found.items():
        check(code, alpha)
        assert code.keys <= most_keys(alpha, 2)


@pytest.mark.parametrize(
    ("keys", "begin", "end"), [(4, 2.0, 5), (5, 7 / 3, 6), (9, 3.0, 10), (16, 4.0, 17)]
)
def test_codes_of_two_steps_are_the_best_up_to_where_the_volume_allows_another(
    keys: int, begin: float, end: int
) -> None:
    """The data's codes on [2, 5**.5), [7/3, 6**.5), [3, 10**.5) and [4, 17**.5)."""
    text = (ROOT / "docs" / "data" / "two-step.csv").read_text(encoding="utf-8")
    found = [
        (float(row["alpha"]), int(row["two_step"])) for row in csv.DictReader(text.splitlines())
    ]
    mine = [count for alpha, count in found if begin <= alpha < end**0.5]
    assert mine
    assert set(mine) == {keys}
    assert most_keys(begin, 2) == most_keys(end**0.5 - 1e-6, 2) == keys
    assert most_keys(end**0.5 + 1e-6, 2) == keys + 1


@pytest.mark.slow
def test_the_check_refuses_a_code_at_too_small_an_alpha(found: dict[float, TwoStepCode]) -> None:
    with pytest.raises(AssertionError):
        check(found[2.75], 2.2)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 9), st.randoms(use_true_random=False))
def test_cliques_of_small_graphs(size: int, random: object) -> None:
    draw = random.random  # type: ignore[attr-defined]
    joined = np.zeros((size, size), dtype=bool)
    for i, j in itertools.combinations(range(size), 2):
        joined[i, j] = joined[j, i] = draw() < 0.6
    largest = max(
        k
        for k in range(1, size + 1)
        for chosen in itertools.combinations(range(size), k)
        if all(joined[i, j] for i, j in itertools.combinations(chosen, 2))
    )
    found = largest_clique(adjacency(joined)).vertices
    assert len(found) == largest
    assert all(joined[i, j] for i, j in itertools.combinations(found, 2))
