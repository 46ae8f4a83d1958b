"""The agreement picture: outlines are the sets' shadows, and marks stand where points lie."""

import math
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import AgreementRule, Gauge
from protocol.messages import Message, PlantModel, PlantStatus
from tests.support.rehearsal import Rehearsal
from wyner.dashboard.plane import Axes, axes_of, draw, fits, outline, verdict


def box(*half_widths: float) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    n = len(half_widths)
    rows = tuple(
        tuple(sign if j == i else 0.0 for j in range(n)) for i in range(n) for sign in (1.0, -1.0)
    )
    return rows, tuple(w for w in half_widths for _ in range(2))


@cache
def said() -> list[Message]:
    return [arrival.message for batch in Rehearsal().arrivals(600) for arrival in batch]


@cache
def statuses() -> tuple[PlantStatus, ...]:
    return tuple(message for message in said() if isinstance(message, PlantStatus))


@cache
def plant_model() -> PlantModel:
    return next(message for message in said() if isinstance(message, PlantModel))


widths = st.floats(0.01, 100)


@given(st.lists(widths, min_size=2, max_size=4), st.data())
def test_a_box_throws_a_box_as_shadow(half_widths: list[float], data: st.DataObject) -> None:
    a, b = data.draw(st.permutations(range(len(half_widths))))[:2]
    H, h = box(*half_widths)
    corners = outline(H, h, Axes(a, b))
    assert {(round(x, 9), round(y, 9)) for x, y in corners} == {
        (round(s * half_widths[a], 9), round(t * half_widths[b], 9))
        for s in (1, -1)
        for t in (1, -1)
    }


@given(st.integers(3, 12))
def test_a_polygon_is_its_own_outline(sides: int) -> None:
    angles = [2 * math.pi * i / sides for i in range(sides)]
    H = tuple((math.cos(a), math.sin(a)) for a in angles)
    corners = outline(H, (1.0,) * sides, Axes(0, 1))
    assert len(corners) == sides
    reach = 1 / math.cos(math.pi / sides)
    assert all(math.isclose(math.hypot(*p), reach) for p in corners)


def test_a_shadow_is_wider_than_the_section_where_the_set_leans() -> None:
    # | x1 - x3 | <= 1 and | x3 | <= 5: on the axis x1 alone the section is 1, the shadow is 6.
    H = ((1.0, 0.0, -1.0), (-1.0, 0.0, 1.0), *box(1, 1, 5)[0][2:])
    corners = outline(H, (1.0, 1.0, 1.0, 1.0, 5.0, 5.0), Axes(0, 1))
    assert max(x for x, _ in corners) == pytest.approx(6)


def test_one_state_is_drawn_as_a_strip() -> None:
    assert axes_of(((1.0,),), *box(0.5)) == Axes(0, -1)
    assert sorted(outline(*box(0.5), Axes(0, -1))) == [(-0.5, -1), (-0.5, 1), (0.5, -1), (0.5, 1)]


def test_axes_follow_the_input_in_widths_of_the_defenders_set() -> None:
    B = ((1.0,), (0.0,), (-3.0,))
    assert axes_of(B, *box(1, 1, 1)) == Axes(2, 0)
    assert axes_of(B, *box(0.1, 1, 1)) == Axes(0, 2)
    assert Axes(2, 0).words == "horizontal x3, vertical x1"


def test_the_picture_has_its_size_both_centres_and_the_next_state() -> None:
    for status in statuses():
        rows = draw(plant_model(), status, 60, 20)
        assert [len(row) for row in rows] == [60] * 20
        cells = [cell for row in rows for cell in row]
        shown = {cell.character for cell in cells if cell.kind == "centre"}
        assert shown == {"0", "1"}, "a number makes way for the state, and stays"
        assert sum(cell.kind == "next" for cell in cells) == 1
        assert {"defender", "eavesdropper"} <= {cell.kind for cell in cells}


def test_marks_lie_as_the_points_do() -> None:
    status = next(s for s in statuses() if s.pictured_k > 100)
    rows = draw(plant_model(), status, 76, 24)
    where = {
        cell.character: (x, y)
        for y, row in enumerate(rows)
        for x, cell in enumerate(row)
        if cell.kind in ("centre", "next")
    }
    # The second candidate is larger and B is positive: its centre lies further right and higher.
    assert where["1"][0] > where["0"][0]
    assert where["1"][1] <= where["0"][1]


def test_the_frame_is_that_of_the_small_sets_and_arrows_say_what_goes_on() -> None:
    status, model = statuses()[-1], plant_model()
    narrow = model.model_copy(update={"alpha": 1.1})
    for drawn, arrows in ((model, 2), (narrow, 0)):
        cells = [cell for row in draw(drawn, status, 60, 20) for cell in row]
        assert sum(cell.character in "◀▶" for cell in cells) == arrows
        # half of the frame and more is what the two small sets and the state span
        columns = {
            x
            for row in draw(drawn, status, 60, 20)
            for x, cell in enumerate(row)
            if cell.kind == "defender"
        }
        assert max(columns) - min(columns) > 40


def test_a_state_outside_every_set_is_still_in_the_picture() -> None:
    status = statuses()[-1].model_copy(update={"pictured_x_next": (50.0, -50.0)})
    rows = draw(plant_model(), status, 40, 12)
    assert rows[0][-1].kind != "next"
    assert sum(cell.kind == "next" for row in rows for cell in row) == 1


def test_a_state_too_far_out_for_a_float_to_span_leaves_the_picture_blank() -> None:
    for x in ((1.7e308, -1.7e308), (-1.7e308, 0.0)):
        status = statuses()[-1].model_copy(update={"pictured_x_next": x, "pictured_x": x})
        assert {c.character for row in draw(plant_model(), status, 10, 4) for c in row} == {" "}


def test_before_the_first_step_the_picture_is_blank() -> None:
    status = statuses()[0].model_copy(update={"pictured_k": -1})
    assert {c.character for row in draw(plant_model(), status, 10, 4) for c in row} == {" "}


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
    update = {"pictured_symbol": said.symbol, "pictured_inside": said.inside}
    assert words in verdict(statuses()[-1].model_copy(update=update))


def marks(status: PlantStatus, model: PlantModel | None = None) -> str:
    cells = [c for line in draw(model or plant_model(), status, 120, 30) for c in line]
    return "".join(sorted(c.character for c in cells if c.kind == "centre"))


@pytest.mark.parametrize(("size", "shown"), [(4, "0123"), (12, "0123456789ab"), (40, "+" * 40)])
def test_every_centre_of_an_alphabet_has_its_mark(size: int, shown: str) -> None:
    last = statuses()[-1]
    candidates = tuple((0.5 * i,) for i in range(size))
    status = last.model_copy(
        update={"pictured_candidates": candidates, "pictured_gauges": (1.5,) * size}
    )
    assert marks(status) == shown


def test_a_grid_of_two_inputs_has_all_its_centres() -> None:
    H, h = box(0.03, 0.03, 0.03, 0.03)
    B = ((0.400086, 0.022762), (0.01209, 0.305529), (0.0, 0.215905), (0.143777, 0.0))
    grid = tuple((0.15 * i, 0.2 * j) for i in range(4) for j in range(4))
    eye = tuple(tuple(float(i == j) for j in range(4)) for i in range(4))
    four = {"A": eye, "B": B, "defender_H": H, "defender_h": h}
    model = plant_model().model_copy(update=four)
    status = statuses()[-1].model_copy(
        update={
            "pictured_x": (0.0,) * 4,
            "pictured_candidates": grid,
            "pictured_x_next": (0.01,) * 4,
        }
    )
    assert fits(model, status)
    assert not fits(plant_model(), status)
    assert set(marks(status, model)) == set("0123456789abcdef")
