"""The design: soundness, the paper's figures, refusals and the cache."""

import tracemalloc
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from controller_service.laws.registry import cached_design
from controller_service.sets.alphabet import choose_alphabet, larger_disturbance
from controller_service.sets.design import Design, SynthesisError, set_corners, synthesise
from controller_service.sets.design_cache import design_path, load, store
from controller_service.sets.terminal import feedback_gain, rakovic, terminal_set
from protocol.convex import Polytope, corners, planar_vertices
from protocol.scenario import Scenario
from runtime.scenario_file import load_scenario, scenario_of
from tests.support.size import size
from wyner.cli.main import main


def changed(scenario: Scenario, **fields: Any) -> Scenario:
    """The scenario with some fields of its control table replaced."""
    data = scenario.model_dump(exclude_none=True)
    data["control"].update(fields)
    for name in [k for k, v in fields.items() if v is None]:
        del data["control"][name]
    return Scenario.model_validate(data)


@pytest.fixture(scope="module")
def paper() -> Scenario:
    return scenario_of("paper")


@pytest.fixture(scope="module")
def tank() -> Scenario:
    return scenario_of("quadruple-tank")


@pytest.fixture(scope="module")
def design(paper: Scenario) -> Design:
    return synthesise(paper)


def test_the_papers_gain_keeps_the_terminal_set(design: Design, paper: Scenario) -> None:
    V = corners(*design.set(0))
    assert np.abs(V @ design.K.T).max() < 6
    H, h = design.set(0)
    reach = (V @ (design.A + design.B @ design.K).T @ H.T).max(axis=0)
    assert (reach + 0.12 * np.abs(H).sum(axis=1) < h).all()


def test_the_terminal_bound_holds(design: Design) -> None:
    # Against the invariant set's own support, summed until nothing is left.
    Ac = design.A + design.B @ design.K
    V = corners(*design.set(0))
    for direction in ([1.0, 0.0], [0.0, 1.0], [0.6, -0.8]):
        d, smallest = np.array(direction), 0.0
        for _ in range(300):
            smallest += 0.12 * np.abs(d).sum()
            d = Ac.T @ d
        outer = float((V @ np.array(direction)).max())
        assert smallest <= outer
        # T_0 is made for a D_c larger by 1e-4, hence the second term.
        assert outer - smallest <= 2 * (design.terminal.bound + 1e-4 * smallest)


@pytest.mark.parametrize("weight", [0.31622776601683794, 0.0014677992676220691])
def test_nearly_parallel_facets_are_kept(paper: Scenario, weight: float) -> None:
    """Weights of which two late terms' normals are 1e-12 apart; T_0 was 1 to 3 percent too wide."""
    regulator = {"next_state": [1.0, 1.0], "input": [weight]}
    scenario = changed(paper, gain=None, regulator=regulator)
    Ac = np.array(paper.A) + np.array(paper.B) @ feedback_gain(scenario)
    inputs, D_c = paper.control.inputs, paper.defender.disturbance
    offsets = choose_alphabet(paper.B, D_c, inputs, alpha=8, size=4).offsets
    for D in (D_c, larger_disturbance(D_c, paper.B, offsets)):
        T0, _ = terminal_set(Ac, D.scaled(1.0001))
        V, DV = corners(T0.H, T0.h), set_corners(D)
        reach = ((V @ Ac.T @ T0.H.T).max(axis=0) + (DV @ T0.H.T).max(axis=0)) / T0.h
        assert reach.max() <= 1 - 1e-9


def steered(scenario: Scenario, design: Design, numbers: set[int]) -> None:
    """A linear program at each corner, with the whole D_c: independent of the recursion."""
    DV = set_corners(scenario.control_set)
    bounds = [(-w, w) for w in scenario.control.inputs.half_widths or ()]
    rng = np.random.default_rng(0)
    for i in numbers:
        H, h = design.set(i - 1)
        eroded = h - (DV @ H.T).max(axis=0)
        V = corners(*design.set(i))
        if len(V) > 120:
            V = rng.permutation(V)[:120]
        G = H @ design.B
        for v in V:
            program = linprog(
                np.r_[np.zeros(G.shape[1]), 1.0],
                A_ub=np.hstack([G, -h[:, None]]),
                b_ub=eroded - H @ design.A @ v,
                bounds=[*bounds, (None, None)],
            )
            assert program.success
            # The variable t is the largest relative excess over the target's rows.
            assert program.fun is not None and program.fun <= 1e-9


@pytest.mark.parametrize("name", ["paper", pytest.param("quadruple-tank", marks=pytest.mark.slow)])
def test_every_corner_of_a_set_is_steered_into_the_set_before(name: str) -> None:
    scenario = scenario_of(name)
    # The tank's first sets have the hard geometry; the oracle is slow, so not all of them.
    design = synthesise(changed(scenario, horizon=6 if name == "quadruple-tank" else 60))
    steered(scenario, design, {1, 2, 3, 6, design.horizon})


@pytest.mark.long
def test_rational_certificate_for_all_sets(paper: Scenario, design: Design) -> None:
    """Each corner of each T_i, exactly, is steered into T_(i-1) ~ D_c by some u in U."""
    A = [[Fraction(v) for v in row] for row in design.A.tolist()]
    B = [Fraction(v) for v in design.B[:, 0].tolist()]
    D = Fraction(0.12)
    exactly = 0
    for i in range(0, design.horizon + 1, size(5, 1)):
        H, h = design.set(i)
        j = max(i - 1, 0)
        G, g = design.set(j)
        rows = [
            (Fraction(p), Fraction(q), Fraction(b))
            for (p, q), b in zip(H.tolist(), h.tolist(), strict=True)
        ]
        before = [
            (Fraction(p), Fraction(q), Fraction(b) - D * (abs(Fraction(p)) + abs(Fraction(q))))
            for (p, q), b in zip(G.tolist(), g.tolist(), strict=True)
        ]
        eroded = g - 0.12 * np.abs(G).sum(axis=1)
        gb, ga = G @ design.B[:, 0], G @ design.A
        for k in range(len(rows)):
            (p, q, b), (r, s, c) = rows[k - 1], rows[k]
            det = p * s - q * r
            assert det > 0  # sorted, no gap of half a turn: T_i is within the hull of the corners
            x = ((b * s - c * q) / det, (p * c - r * b) / det)
            xf = np.array([float(x[0]), float(x[1])])
            if i == 0:
                u = float(design.K[0] @ xf)
            else:
                room = eroded - ga @ xf
                high = min(6.0, (room[gb > 1e-12] / gb[gb > 1e-12]).min())
                low = max(-6.0, (room[gb < -1e-12] / gb[gb < -1e-12]).max())
                u = min(6.0, max(-6.0, 0.5 * (low + high)))
            assert abs(u) <= 6
            uf = Fraction(u)
            y = [A[n][0] * x[0] + A[n][1] * x[1] + B[n] * uf for n in range(2)]
            yf = np.array([float(y[0]), float(y[1])])
            # A row with more room than any rounding can take is certain; the others are exact.
            scale = np.abs(G) @ np.abs(yf) + np.abs(g) + 1
            doubtful = np.flatnonzero(eroded - G @ yf <= 1e-14 * scale)
            for n in doubtful:
                a1, a2, bound = before[n]
                assert a1 * y[0] + a2 * y[1] <= bound, (i, k)
                exactly += 1
    assert exactly > size(200, 1000)  # the filter leaves the touching rows to exact arithmetic


def test_every_state_of_a_drives_sets_is_steered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its current decays by 12 a step: sets grew as fast, until rounding dropped their facets."""
    monkeypatch.chdir(tmp_path)
    matrices = ["--A", "[0 1 0; 0 -0.1 0.5; 0 -0.5 -50]", "--B", "[0; 0; 50]", "--continuous"]
    assert main(["new", "drive", *matrices, "--period", "0.05"]) == 0
    scenario = load_scenario(tmp_path / "drive.toml")
    design = synthesise(scenario)
    assert design.horizon >= 4
    steered(scenario, design, set(range(1, design.horizon + 1)))


def test_a_disturbance_of_many_facets_is_designed_in_little_memory() -> None:
    """Sums of supports were held for all terms at once: gigabytes here."""
    turn = 2 * np.pi * (np.arange(200) + 0.25) / 200
    H = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    Ac = 0.96 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    D = Polytope(H, np.full(200, 0.12))
    tracemalloc.start()
    T0, terminal = rakovic(Ac, D)
    assert tracemalloc.get_traced_memory()[1] < 200e6
    tracemalloc.stop()
    V = planar_vertices(T0)
    needed = (V @ Ac.T @ T0.H.T).max(axis=0) + (planar_vertices(D) @ T0.H.T).max(axis=0)
    assert (needed <= T0.h * (1 + 1e-12)).all()
    assert terminal.order > 100


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"gain": [[1.0, 0.0]]}, "does not stabilise"),
        ({"inputs": {"half_widths": [3.0]}}, "not within control.inputs"),
        ({"states": {"half_widths": [0.2, 0.2]}}, "control.states"),
    ],
)
def test_refusals_are_one_line(paper: Scenario, fields: dict[str, Any], words: str) -> None:
    with pytest.raises(SynthesisError, match=words) as caught:
        synthesise(changed(paper, **fields))
    assert "\n" not in str(caught.value)


def test_cache(paper: Scenario, tmp_path: Path) -> None:
    short = changed(paper, horizon=20)
    first = cached_design(short, cache_dir=tmp_path)
    second = cached_design(short, cache_dir=tmp_path)
    assert (first.cached, second.cached) == (False, True)
    for one, two in zip(first.T + first.targets, second.T + second.targets, strict=True):
        assert np.array_equal(one[0], two[0])
        assert np.array_equal(one[1], two[1])
    assert np.array_equal(first.K, second.K)
    assert (first.margins, first.terminal) == (second.margins, second.terminal)
    assert len(list(tmp_path.iterdir())) == 1
    assert store(replace(first, stopped=True), "of sets cut short", tmp_path)
    cut = load("of sets cut short", tmp_path)
    assert cut is not None
    assert cut.stopped


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "foreign"])
def test_a_damaged_or_foreign_file_is_rebuilt(paper: Scenario, tmp_path: Path, damage: str) -> None:
    short = changed(paper, horizon=5)
    fresh = cached_design(short, cache_dir=tmp_path)
    path = design_path(short.design_fingerprint(), tmp_path)
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[len(data) // 2] ^= 1
    elif damage == "cut":
        del data[len(data) // 2 :]
    elif damage == "empty":
        data.clear()
    else:
        other = changed(paper, horizon=6)
        cached_design(other, cache_dir=tmp_path)
        data = bytearray(design_path(other.design_fingerprint(), tmp_path).read_bytes())
    path.write_bytes(data)
    rebuilt = cached_design(short, cache_dir=tmp_path)
    assert not rebuilt.cached
    assert np.array_equal(rebuilt.set(5)[1], fresh.set(5)[1])
    assert cached_design(short, cache_dir=tmp_path).cached
