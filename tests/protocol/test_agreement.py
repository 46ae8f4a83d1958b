"""The agreement test: what the paper says of it, and one verdict whoever computes it."""

import math
from itertools import product

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import INSIDE, NO_SYMBOL, AgreementRule, Gauge, predict
from protocol.link.session import rules_of
from runtime.scenario_file import scenario_of

Case = tuple[tuple[float, ...], tuple[tuple[float, ...], ...], int, tuple[float, ...]]

PAPER = rules_of(scenario_of("paper")).agreement
TANKS = rules_of(scenario_of("quadruple-tank")).agreement

ROUNDING = 1e-11
"""What a gauge may be off by where a state of some tens is compared with half-widths of 0.1."""

few = st.integers(2, 5)
coordinates = st.floats(-20, 20, allow_nan=False)
unit = st.floats(-1, 1, allow_nan=False)
alphas = st.floats(1, 10, allow_nan=False)


def rule(alpha: float, like: AgreementRule = PAPER) -> AgreementRule:
    return AgreementRule(A=like.A, B=like.B, gauge=like.gauge, alpha=alpha)


def defender_widths(of: AgreementRule) -> tuple[float, ...]:
    assert of.gauge.half_widths is not None
    return of.gauge.half_widths


@st.composite
def transitions(
    draw: st.DrawFn, like: AgreementRule = PAPER, size: st.SearchStrategy[int] = few
) -> Case:
    """(x, candidates, the one applied, x_next), the disturbance inside D_c."""
    n, m = len(like.A), len(like.B[0])
    x = tuple(draw(coordinates) for _ in range(n))
    candidates = tuple(
        tuple(draw(st.floats(-6, 6, allow_nan=False)) for _ in range(m)) for _ in range(draw(size))
    )
    coin = draw(st.integers(0, len(candidates) - 1))
    centre = predict(like.A, like.B, x, candidates[coin])
    x_next = tuple(c + draw(unit) * w for c, w in zip(centre, defender_widths(like), strict=True))
    return x, candidates, coin, x_next


# --- what the paper says -------------------------------------------------------------------------


@given(transitions())
def test_equation_14_the_applied_input_explains_the_next_state(case: Case) -> None:
    x, candidates, coin, x_next = case
    assert PAPER.verdict(x, candidates, x_next).gauges[coin] <= 1 + ROUNDING


@given(transitions(), alphas)
def test_equation_22_an_agreed_symbol_is_the_coin(case: Case, alpha: float) -> None:
    x, candidates, coin, x_next = case
    verdict = rule(alpha).verdict(x, candidates, x_next)
    if verdict.agreed:
        assert verdict.symbol == coin


@given(transitions(), alphas)
def test_equation_21_one_is_possible_for_the_defender_all_for_the_eavesdropper(
    case: Case,
    alpha: float,
) -> None:
    x, candidates, _, x_next = case
    verdict = rule(alpha).verdict(x, candidates, x_next)
    inside = [i for i, g in enumerate(verdict.gauges) if g <= INSIDE]
    possible = all(g <= alpha for g in verdict.gauges)
    assert verdict.agreed == (len(inside) == 1 and possible)
    assert verdict.symbol == (inside[0] if verdict.agreed else NO_SYMBOL)


@given(transitions(like=TANKS, size=st.integers(2, 3)), alphas)
def test_the_nearest_centre_is_the_symbol_whatever_the_scale(case: Case, alpha: float) -> None:
    """An eavesdropper with the right shape of D_e needs neither alpha nor D_c."""
    x, candidates, _, x_next = case
    verdict = rule(alpha, TANKS).verdict(x, candidates, x_next)
    if not verdict.agreed:
        return
    hers = Gauge(half_widths=tuple(alpha * w for w in defender_widths(TANKS)))
    scaled = [
        hers([a - c for a, c in zip(x_next, predict(TANKS.A, TANKS.B, x, u), strict=True)])
        for u in candidates
    ]
    assert scaled.index(min(scaled)) == verdict.symbol


@given(transitions())
def test_more_asymmetry_never_loses_an_agreement(case: Case) -> None:
    x, candidates, _, x_next = case
    symbols = [rule(a).verdict(x, candidates, x_next).symbol for a in (1.0, 1.5, 3.0, 8.0, 1e9)]
    agreed = [s for s in symbols if s != NO_SYMBOL]
    assert symbols == [NO_SYMBOL] * (len(symbols) - len(agreed)) + agreed
    assert len(set(agreed)) <= 1


@given(transitions(), st.permutations(range(5)))
def test_renaming_the_candidates_renames_the_symbol(case: Case, order: list[int]) -> None:
    x, candidates, _, x_next = case
    order = [i for i in order if i < len(candidates)]
    verdict = PAPER.verdict(x, candidates, x_next)
    renamed = PAPER.verdict(x, tuple(candidates[i] for i in order), x_next)
    assert renamed.gauges == tuple(verdict.gauges[i] for i in order)
    assert renamed.agreed == verdict.agreed
    if verdict.agreed:
        assert order[renamed.symbol] == verdict.symbol


def test_the_edges_belong_to_the_sets() -> None:
    gauge = Gauge(half_widths=(1.0,))
    candidates = ((0.0,), (4.0,))

    def symbol(alpha: float, x_next: float) -> int:
        line = AgreementRule(A=((1.0,),), B=((1.0,),), gauge=gauge, alpha=alpha)
        return line.verdict((0.0,), candidates, (x_next,)).symbol

    assert symbol(3.0, 1.0) == 0
    assert symbol(math.nextafter(3.0, 0.0), 1.0) == NO_SYMBOL  # the eavesdropper rules u_1 out
    assert symbol(3.0, math.nextafter(INSIDE, 0.0)) == 0  # the edge, to rounding
    assert symbol(3.0, math.nextafter(INSIDE, 2.0)) == NO_SYMBOL  # nobody's
    line = AgreementRule(A=((1.0,),), B=((1.0,),), gauge=gauge, alpha=3.0)
    touching = ((0.0,), (2.0,))
    assert line.verdict((0.0,), touching, (1.0,)).symbol == NO_SYMBOL  # on both edges


def test_a_number_that_is_none_is_never_agreed() -> None:
    for bad in (math.nan, math.inf, -math.inf):
        assert not PAPER.verdict((0.0, 0.0), ((0.0,), (3.0,)), (bad, 0.0)).agreed
        assert not PAPER.verdict((0.0, 0.0), ((0.0,), (bad,)), (0.0, 0.0)).agreed


@given(transitions(like=PAPER), alphas)
def test_the_unrolled_plane_is_the_general_order(case: Case, alpha: float) -> None:
    """A third, empty state turns the unrolled branches off and must change no bit."""
    x, candidates, _, x_next = case
    A = (*((*row, 0.0) for row in PAPER.A), (0.0, 0.0, 0.0))
    B = (*PAPER.B, (0.0,))
    padded = AgreementRule(A, B, Gauge(half_widths=(*defender_widths(PAPER), 1.0)), alpha)
    assert padded.verdict((*x, 0.0), candidates, (*x_next, 0.0)) == rule(alpha).verdict(
        x, candidates, x_next
    )


# --- gauges --------------------------------------------------------------------------------------


def box_as_rows(widths: tuple[float, ...]) -> Gauge:
    """The box as a polytope that the constructor cannot see to be one: rows out of order."""
    n = len(widths)
    H = [[0.0] * n for _ in range(2 * n)]
    for i in range(n):
        H[i][i], H[n + i][i] = 1.0, -1.0
    return Gauge(H=tuple(tuple(row) for row in H), h=widths * 2)


@given(
    st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=4).flatmap(
        lambda w: st.tuples(
            st.just(tuple(w)),
            st.lists(st.floats(-1e6, 1e6), min_size=len(w), max_size=len(w)),
        )
    )
)
def test_a_box_and_its_rows_have_one_gauge(case: tuple[tuple[float, ...], list[float]]) -> None:
    widths, v = case
    assert Gauge(half_widths=widths)(v) == box_as_rows(widths)(v)


def test_rows_in_pairs_are_seen_to_be_a_box() -> None:
    rows = scenario_of("quadruple-tank").defender.disturbance.rows()
    assert Gauge.from_rows(*rows).half_widths == (0.03, 0.03, 0.03, 0.03)
    lopsided = (rows[0], (0.03, 0.04, *rows[1][2:]))
    assert Gauge.from_rows(*lopsided).half_widths is None


HEXAGON = Gauge(
    H=tuple((math.cos(a * math.pi / 3), math.sin(a * math.pi / 3)) for a in range(6)),
    h=(1.0, 1.5, 1.0, 1.0, 1.5, 2.0),
)


def test_a_gauge_is_the_smallest_scale_that_holds_the_vector() -> None:
    H, h = np.array(HEXAGON.H), np.array(HEXAGON.h)
    for a, b in product(np.linspace(-3, 3, 13), repeat=2):
        g = HEXAGON((a, b))
        assert (H @ [a, b] <= g * h + 1e-12).all()
        if g > 0:
            assert not (H @ [a, b] <= 0.999 * g * h).all()
