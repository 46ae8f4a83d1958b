"""Fresh orthogonal matrices: orthogonal, uniform, and undone at the other end."""

import math

import numpy as np
import pytest
from scipy.stats import kstest

from studies.attacks.defences import Coding, StaticCoding, matrices, turned, words_of

DRAWS = 20_000


def drawn(n: int, draws: int = DRAWS) -> np.ndarray:
    words = np.random.default_rng(7).integers(1 << 32, size=(draws, words_of(n)), dtype=np.uint32)
    return matrices(words, n)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_every_matrix_is_orthogonal(n: int) -> None:
    S = drawn(n, 500)
    assert np.abs(S @ np.swapaxes(S, -1, -2) - np.eye(n)).max() < 1e-14


@pytest.mark.parametrize("n", [3, 4])
def test_every_direction_is_as_likely_as_any_other(n: int) -> None:
    """Of a uniform unit vector (1 + v_i) / 2 is Beta((n - 1) / 2, (n - 1) / 2)."""
    S = drawn(n)
    for row in range(n):
        for column in range(n):
            half = (n - 1) / 2
            assert kstest((1 + S[:, row, column]) / 2, "beta", args=(half, half)).pvalue > 1e-4
    # orthonormal columns, and both signs of the determinant: the traces' moments of O(n)
    traces = np.trace(S, axis1=-2, axis2=-1)
    assert abs(traces.mean()) < 5 / math.sqrt(DRAWS)
    assert abs((traces**2).mean() - 1) < 5 * math.sqrt(2 / DRAWS)
    assert abs((traces**4).mean() - 3) < 5 * math.sqrt(96 / DRAWS)
    assert abs(np.linalg.det(S).mean()) < 5 / math.sqrt(DRAWS)


def test_a_rotation_turns_by_a_uniform_angle() -> None:
    S = drawn(2)
    angle = np.arctan2(S[:, 1, 0], S[:, 0, 0]) % (2 * math.pi)
    assert kstest(angle / (2 * math.pi), "uniform").pvalue > 1e-4
    assert np.allclose(np.linalg.det(S), 1)


def test_the_words_are_each_of_use() -> None:
    for n in (1, 2, 3, 4):
        words = np.full((words_of(n) + 1, words_of(n)), 1 << 30, dtype=np.uint32)
        for i in range(words_of(n)):
            words[i, i] = 3 << 30
        S = matrices(words, n)
        for i in range(words_of(n)):
            assert np.abs(S[i] - S[-1]).max() > 0.1


@pytest.mark.parametrize("kind", [Coding, StaticCoding])
@pytest.mark.parametrize("n", [1, 2, 4])
def test_the_other_end_undoes_it(kind: type[Coding], n: int) -> None:
    defence, draw = kind(n, 4), np.random.default_rng(7)
    session, step = defence.session_key(draw, (50,)), defence.step_key(draw, (50,))
    x = draw.normal(size=(50, n))
    wire = defence.encode(3, session, step, x)
    assert np.allclose(np.linalg.norm(wire.values, axis=-1), np.linalg.norm(x, axis=-1))
    opened = defence.decode(3, session, step, wire)
    assert np.abs(opened.x - x).max() < 1e-14
    assert not opened.alarm.any()


def test_a_correction_that_is_not_turned_is_left_over() -> None:
    """2 sin(phi / 2) abs(e) of it, for the angle phi between her matrix and the true one."""
    S, T = matrices(np.array([[1 << 30]], np.uint32), 2), matrices(np.array([[0]], np.uint32), 2)
    e = np.array([[0.3, 0.4]])
    left = e - turned(np.swapaxes(S, -1, -2), turned(T, e))
    assert np.linalg.norm(left) == pytest.approx(2 * math.sin(math.pi / 4) * 0.5, rel=1e-6)


def test_the_key_that_it_costs() -> None:
    assert [Coding(n, 4).key_bits for n in (1, 2, 3, 4)] == [32, 32, 192, 320]
    assert StaticCoding(2, 4).key_bits == 0


def test_too_few_words_are_one_line() -> None:
    with pytest.raises(ValueError, match="coding: got 1 words, expected 6 for n = 3"):
        matrices(np.zeros((4, 1), np.uint32), 3)
