"""A D_e of its own shape in the loop: engine, scalar loop, law and taps."""

from functools import cache

import numpy as np
import pytest

from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.alphabet import choose_alphabet, largest_certain
from controller_service.sets.separation import AlphabetError, Separation
from protocol.agreement import NO_SYMBOL
from protocol.scenario import ConvexSet, Scenario
from studies.signalling import changed
from tap_service.eavesdroppers import named
from tap_service.inference.fitted_shape import fitted_widths
from wyner.simulate.engine import Runs, simulate_runs, transfer
from wyner.simulate.engine.link import Transfer
from wyner.simulate.engine.taps import transcript

MESSAGE = b"We sail at dawn."


def shaped(widths: tuple[float, float], spacing: float = 2.0, size: int = 2) -> Scenario:
    return changed(
        "packed",
        secrecy={"alpha": 1.0, "candidates": size, "disturbance": {"half_widths": list(widths)}},
        control={"alphabet": {"spacing": spacing}},
    )


@cache
def played(
    widths: tuple[float, float], spacing: float = 2.0, size: int = 2, steps: int = 600
) -> tuple[Scenario, Runs, Transfer]:
    scenario = shaped(widths, spacing, size)
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(scenario, law, seed=7, runs=range(3), steps=steps, record=True)
    return scenario, runs, transfer(runs, payloads=[MESSAGE])


def rights(
    name: str, case: tuple[Scenario, Runs, Transfer], place: int
) -> tuple[float, list[bytes]]:
    """Share of the key symbols that she names in the end, and her whole messages."""
    scenario, runs, link = case
    told = scenario.oracle_knowledge() if name == "oracle" else scenario.knowledge()
    tap = named(name)(told)
    live = [tap.observe(t).best for t in transcript(runs, link, place)]
    best = {**dict(enumerate(live)), **{g.k: g.best for g in (*tap.final_guesses, *tap.review())}}
    keys = link.agreed[:, place]
    steps = np.flatnonzero(keys != NO_SYMBOL)
    assert len(steps) > 0.9 * len(keys)
    share = float(np.mean([best[k] == keys[k] for k in steps.tolist()]))
    return share, list(tap.belief().whole)


@pytest.mark.long
@pytest.mark.parametrize(
    ("widths", "spacing", "nearest"),
    [((0.96, 0.96), 2.0, 1.0), ((0.24, 0.96), 2.0, 0.80), ((0.13, 0.96), 1.9999, 0.66)],
)
def test_the_nearest_in_her_shape_is_the_key_only_where_it_is_that_of_d_c(
    widths: tuple[float, float], spacing: float, nearest: float
) -> None:
    case = played(widths, spacing)
    shares = [rights("nearest-centre", case, place)[0] for place in range(3)]
    assert np.mean(shares) == pytest.approx(nearest, abs=0.04)
    for place in range(3):
        share, whole = rights("text", case, place)
        assert share == 1.0
        assert MESSAGE in whole
        assert rights("oracle", case, place) == (1.0, [MESSAGE])


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
