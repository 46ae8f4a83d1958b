"""The key test's panel: bars where the gauges are, and the verdict of the test itself."""

from functools import cache

import pytest

from protocol.agreement import AgreementRule, Gauge
from protocol.messages import PlantModel
from protocol.messages.management import PicturedStep
from tests.dashboard.states import state_after
from wyner.dashboard.picture import agreement, spread, verdict
from wyner.dashboard.text import BEYOND, DOT


@cache
def seen() -> tuple[PlantModel, PicturedStep]:
    state = state_after(600)
    assert state.model is not None
    assert state.pictured is not None
    return state.model, state.pictured


@pytest.mark.parametrize(
    ("gauges", "words"),
    [
        ((0.5, 3.0), "KEY 0: only input 0 explains it"),
        ((3.0, 0.5), "KEY 1: only input 1 explains it"),
        ((3.0, 1.0 + 5e-10), "KEY 1: only input 1 explains it"),  # inside, to rounding
        ((0.5, 0.9), "2 inputs explain it"),
        ((0.9, 1.0 + 5e-10), "2 inputs explain it"),
        ((1.5, 2.0), "no input explains it"),
        ((0.5, 9.0), "outside a D_e"),
    ],
)
def test_the_verdict_says_why(gauges: tuple[float, ...], words: str) -> None:
    """The reason is the agreement test's own: the screen derives none."""
    rule = AgreementRule(((1.0,),), ((1.0,),), Gauge(half_widths=(1.0,)), alpha=8.0)
    said = rule.verdict((0.0,), tuple((g,) for g in gauges), (0.0,))
    assert said.gauges == gauges
    update = {"symbol": said.symbol, "inside": said.inside}
    assert words in verdict(seen()[1].model_copy(update=update))


def test_a_mark_is_in_the_half_of_its_bar_that_the_gauge_says() -> None:
    model, step = seen()
    gauges = (0.0, 0.9, 1.0 + 5e-10, 1.2, 7.9, 9.0)
    step = step.model_copy(update={"gauges": gauges})
    rows = [row.plain for row in agreement(model, step, 60, 20)]
    places = [max(row.find(DOT), row.find(BEYOND)) for row in rows[1:7]]
    edge = rows[7].index("D_c")
    assert places == sorted(places)
    assert [at < edge for at in places] == [True] * 3 + [False] * 3
    words = ["in D_c"] * 3 + ["outside"] * 2 + ["beyond"]
    assert all(word in row for row, word in zip(rows[1:7], words, strict=True))
    fewer = [row.plain for row in agreement(model, step, 60, 5)]
    assert [row[:3] for row in fewer[1:3]] == [" 0 ", " 1 "]
    assert "and 4 more" in fewer[3]


def test_a_d_e_of_its_own_shape_is_as_wide_as_its_farthest_corner() -> None:
    model = seen()[0]
    assert spread(model) == model.alpha
    box = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
    widths = {"defender_H": box, "defender_h": (1.0, 1.0, 2.0, 2.0)}
    own = {"eavesdropper_H": box, "eavesdropper_h": (3.0, 3.0, 2.0, 2.0)}
    assert spread(model.model_copy(update=widths | own)) == pytest.approx(3.0)
