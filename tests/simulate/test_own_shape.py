"""A D_e of its own shape in the loop: engine, scalar loop, law and taps."""

import numpy as np
import pytest

from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.alphabet import choose_alphabet, largest_certain
from controller_service.sets.separation import AlphabetError, Separation
from protocol.scenario import ConvexSet
from studies.listeners import heard
from studies.signalling import changed
from tap_service.capture.channel import View
from tap_service.inference.fitted_shape import fitted_widths
from wyner.simulate.engine import Runs, simulate_runs, transfer
from wyner.simulate.engine.link import Transfer

MESSAGE = b"We sail at dawn."


def played(widths: tuple[float, float], spacing: float) -> tuple[Runs, Transfer]:
    scenario = changed(
        "packed",
        secrecy={"alpha": 1.0, "candidates": 2, "disturbance": {"half_widths": list(widths)}},
        control={"alphabet": {"spacing": spacing}},
    )
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(scenario, law, seed=7, runs=range(3), steps=600, record=True)
    return runs, transfer(runs, payloads=[MESSAGE])


@pytest.mark.long
@pytest.mark.parametrize(
    ("widths", "spacing", "nearest"),
    [((0.96, 0.96), 2.0, 1.0), ((0.24, 0.96), 2.0, 0.80), ((0.13, 0.96), 1.9999, 0.66)],
)
def test_the_nearest_in_her_shape_is_the_key_only_where_it_is_that_of_d_c(
    widths: tuple[float, float], spacing: float, nearest: float
) -> None:
    runs, link = played(widths, spacing)
    by_run = [heard(("nearest-centre", "text"), (runs, link), View(), place) for place in range(3)]
    assert all(near.keys > 0.9 * runs.steps for near, _ in by_run)
    shares = [near.later / near.keys for near, _ in by_run]
    assert np.mean(shares) == pytest.approx(nearest, abs=0.04)
    for _, text in by_run:
        assert text.later == text.keys
        assert MESSAGE in text.belief.whole


def test_a_fit_of_noise_alone_is_not_trusted_to_be_smaller_than_the_noise() -> None:
    """Candidates that lead to one place tell nothing, and fit whatever they are."""
    rng = np.random.default_rng(1)
    d = rng.uniform(-1, 1, (200, 1, 2))
    along = np.concatenate([d, -d], axis=2).repeat(2, axis=1)
    assert fitted_widths(along) == pytest.approx(np.abs(along).max(axis=(0, 1)), rel=0.05)


# --- the alphabet --------------------------------------------------------------------------------


@pytest.mark.parametrize("widths", [(0.24, 0.96), (0.13, 0.96), (0.96, 0.3), (0.5, 1.3)])
def test_the_largest_alphabet_is_certain_at_every_corner_and_one_more_is_not(
    widths: tuple[float, float],
) -> None:
    B, D_c = ((0.0246,), (0.4877,)), ConvexSet(half_widths=(0.12, 0.12))
    hers = ConvexSet(half_widths=widths)
    most = largest_certain(Separation.of(B, D_c, hers), 1.0)
    corners = 0.12 * np.array([(a, b) for a in (-1, 1) for b in (-1, 1)])

    def certain(offsets: np.ndarray) -> bool:
        push = (offsets[:, None] - offsets[None]) @ np.array(B).T
        v = np.abs(push[:, :, None] + corners)
        off = ~np.eye(len(offsets), dtype=bool)
        return bool((v <= np.array(widths)).all()) and bool((v[off] > 0.12).any(axis=2).all())

    U = ConvexSet(half_widths=(6.0,))
    chosen = choose_alphabet(B, D_c, U, alpha=1.0, size=most, shape=hers)
    assert certain(chosen.offsets)
    step = 0.24 / 0.4877 * (1 + 1e-6)
    assert not certain(np.arange(most + 1)[:, None] * step)
    with pytest.raises(AlphabetError, match=rf"got {most + 1}, expected at most {most}"):
        choose_alphabet(B, D_c, U, alpha=1.0, size=most + 1, shape=hers)
