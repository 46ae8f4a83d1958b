"""A D_e of its own shape: equation (11) asks that it contains D_c, and no more."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.agreement import INSIDE, AgreementRule, Gauge
from protocol.link.session import rules_of
from protocol.scenario import Scenario, ScenarioError, parse_scenario
from runtime.scenario_file import scenario_of

finite = st.floats(-3, 3, allow_nan=False)


def with_shape(disturbance: object, alpha: float = 1.0, name: str = "packed") -> Scenario:
    data = scenario_of(name).model_dump(exclude_none=True)
    data["secrecy"] |= {"alpha": alpha, "disturbance": disturbance}
    return parse_scenario(data, name)


@pytest.mark.parametrize(
    ("disturbance", "alpha", "line"),
    [
        ({"half_widths": [0.11, 0.96]}, 1.0, "secrecy.disturbance: expected a set that, times"),
        ({"half_widths": [0.24]}, 1.0, "secrecy.disturbance: got shape 1, expected 2"),
        ({"half_widths": [0.0, 1.0]}, 1.0, "secrecy.disturbance.half_widths.0: got 0.0"),
        ({"half_widths": [1e308, 1.0]}, 100.0, "secrecy.disturbance.half_widths.0: got 1e+308"),
        ({"H": [[1.0, 0.0]], "h": [1.0, 1.0]}, 1.0, "expected as many entries in h"),
    ],
)
def test_a_wrong_shape_is_one_line(disturbance: object, alpha: float, line: str) -> None:
    with pytest.raises(ScenarioError, match=r"secrecy") as found:
        with_shape(disturbance, alpha)
    assert line in str(found.value)
    assert len(found.value.problems) == 1


def test_alpha_scales_it_and_may_be_what_holds_d_c() -> None:
    assert with_shape({"half_widths": [0.03, 0.12]}, 4.0).eavesdropper_set.half_widths == (
        0.12,
        0.48,
    )


def test_she_is_told_it_and_the_oracle_d_c_too() -> None:
    scenario = with_shape({"half_widths": [0.12, 0.48]}, 2.0)
    told, oracle = scenario.knowledge(), scenario.oracle_knowledge()
    assert told.disturbance_h == (0.24, 0.24, 0.96, 0.96)
    assert (told.alpha, told.defender_H, told.defender_h) == (None, None, None)
    assert (oracle.alpha, oracle.defender_h) == (2.0, (0.12,) * 4)
    assert oracle.without_secrets() == told
    assert scenario_of("packed").oracle_knowledge().defender_h is None
    assert (scenario.hidden_widths, scenario_of("packed").hidden_widths) == (2, 1)


def test_both_ends_compare_it() -> None:
    plain, one, other = (
        scenario_of("packed"),
        with_shape({"half_widths": [0.24, 0.96]}),
        with_shape({"half_widths": [0.25, 0.96]}),
    )
    assert len({s.fingerprint() for s in (plain, one, other)}) == 3
    assert len({s.law_fingerprint() for s in (plain, one, other)}) == 3
    assert len({s.design_fingerprint() for s in (plain, one, other)}) == 3
    assert rules_of(one).agreement.reach == Gauge(half_widths=(0.24, 0.96))
    assert rules_of(plain).agreement.reach is None


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(finite, finite), min_size=2, max_size=4),
    st.tuples(finite, finite),
    st.floats(1, 4),
)
def test_the_verdict_is_equation_20_with_two_sets(
    predictions: list[tuple[float, float]], x_next: tuple[float, float], alpha: float
) -> None:
    D_c, D_e = np.array([0.5, 0.5]), np.array([0.6, 2.0])
    eye = ((1.0, 0.0), (0.0, 1.0))
    rule = AgreementRule(
        eye, eye, Gauge(half_widths=(0.5, 0.5)), alpha, Gauge(half_widths=(0.6, 2.0))
    )
    v = np.abs(np.array(x_next) - np.array(predictions))
    defender = (v / D_c).max(axis=1) <= INSIDE
    hers = (v / D_e).max(axis=1) <= alpha
    verdict = rule.verdict_at(predictions, x_next)
    agreed = bool(hers.all()) and int(defender.sum()) == 1
    assert verdict.agreed == agreed
    assert rule.widest(predictions, x_next) == (v / D_e).max()
    if agreed:
        assert verdict.symbol == int(np.flatnonzero(defender)[0])
