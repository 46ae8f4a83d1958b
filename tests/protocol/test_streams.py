"""Random draws: indexed access is the sequential generator, from any place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.streams import BLOCK, CIPHER, COIN, DISTURBANCE, SeededSymbols, Stream, generator
from runtime.chance import SystemSymbols, noise, symbols

ROWS = 3 * BLOCK + 5


@pytest.mark.parametrize("width", [1, 2, 4])
@pytest.mark.parametrize("stream", [DISTURBANCE, COIN, CIPHER])
def test_by_index_is_in_sequence(stream: int, width: int) -> None:
    sequential = generator(2026, 0, stream).random((ROWS, width))
    indexed = Stream(2026, stream, width=width)
    assert [indexed.at(i) for i in range(ROWS)] == [tuple(row) for row in sequential.tolist()]


@given(st.lists(st.integers(0, ROWS - 1), max_size=20))
def test_any_order_gives_the_same_draws(places: list[int]) -> None:
    sequential = generator(5, 3, COIN).random((ROWS, 2))
    jumping = Stream(5, COIN, width=2, run=3)
    for i in places:
        assert jumping.at(i) == tuple(sequential[i])


def test_streams_and_runs_and_seeds_are_apart() -> None:
    draws = {
        Stream(seed, stream, run=run).at(0)
        for seed in (0, 1)
        for run in (0, 1)
        for stream in (DISTURBANCE, COIN, CIPHER)
    }
    assert len(draws) == 12


@pytest.mark.parametrize("size", [2, 3, 16])
def test_seeded_symbols_are_uniform_and_repeat(size: int) -> None:
    drawn = [SeededSymbols(9, CIPHER).symbol(0, size), *_draw(SeededSymbols(9, CIPHER), size)]
    assert drawn[0] == drawn[1]
    assert _draw(SeededSymbols(9, CIPHER), size) == drawn[1:]
    counts = np.bincount(drawn[1:], minlength=size)
    expected = 4096 / size
    assert ((counts - expected) ** 2 / expected).sum() < 45  # chi-square, 15 degrees at most: 1e-4


def _draw(source: SeededSymbols, size: int) -> list[int]:
    return [source.symbol(j, size) for j in range(4096)]


def test_without_a_seed_the_system_draws() -> None:
    assert isinstance(symbols(None, COIN), SystemSymbols)
    assert isinstance(symbols(1, COIN), SeededSymbols)
    drawn = [SystemSymbols().symbol(0, 16) for _ in range(400)]
    assert set(drawn) == set(range(16))  # one is missing by chance in 16 (15/16)^400 < 1e-9
    assert noise(None, 2).at(0) != noise(None, 2).at(0)
    assert noise(4, 2).at(0) == noise(4, 2).at(0) == Stream(4, DISTURBANCE, width=2).at(0)
