"""The agreement picture: outlines are the sets, and marks stand where points lie."""

from functools import cache

import pytest

from protocol.agreement import AgreementRule, Gauge
from protocol.messages import Message, PlantModel, PlantStatus
from tests.support.rehearsal import Rehearsal
from wyner.dashboard.picture import verdict
from wyner.dashboard.plane import Axes, axes_of, draw, fits


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


def test_axes_follow_the_input_in_widths_of_the_defenders_set() -> None:
    H, h = box(0.1, 1, 1)
    eye = tuple(tuple(float(i == j) for j in range(3)) for i in range(3))
    three = {"A": eye, "B": ((1.0,), (0.0,), (-3.0,)), "defender_H": H, "defender_h": h}
    assert axes_of(plant_model().model_copy(update=three)) == Axes(0, 2)
    assert Axes(2, 0).words == "horizontal x3, vertical x1"


def test_the_state_is_drawn_inside_a_leaning_set_exactly_where_the_gauge_says_so() -> None:
    """A shadow of the set would hold states that the test finds outside."""
    H = ((1.0, 1.0, 1.0), (-1.0, -1.0, -1.0), (1.0, -1.0, 0.0), (-1.0, 1.0, 0.0),
         (0.0, 1.0, -1.0), (0.0, -1.0, 1.0))  # fmt: skip
    h = (1.0,) * 6
    eye = tuple(tuple(float(i == j) for j in range(3)) for i in range(3))
    leaning = {"A": eye, "B": ((9.0,), (8.0,), (7.0,)), "defender_H": H, "defender_h": h}
    model = plant_model().model_copy(update=leaning)
    for far, held in ((0.3, True), (0.9, False)):
        step = {
            "pictured_x": (0.0,) * 3,
            "pictured_candidates": ((0.0,), (1.0,)),
            "pictured_x_next": (0.0, 0.0, far * 1.2),
        }
        rows = draw(model, statuses()[-1].model_copy(update=step), 60, 20)
        y, x = next(
            (y, x) for y, row in enumerate(rows) for x, c in enumerate(row) if c.style == "next"
        )
        edges = [i for i, cell in enumerate(rows[y]) if cell.style == "defender"]
        around = any(i < x for i in edges) and any(i > x for i in edges)
        assert (bool(edges) and around) == held


def test_the_picture_has_its_size_both_centres_and_the_next_state() -> None:
    for status in statuses():
        rows = draw(plant_model(), status, 60, 20)
        assert [len(row) for row in rows] == [60] * 20
        cells = [cell for row in rows for cell in row]
        shown = {cell.character for cell in cells if cell.style == "centre"}
        assert shown == {"0", "1"}, "a number makes way for the state, and stays"
        assert sum(cell.style == "next" for cell in cells) == 1
        assert {"defender", "eavesdropper"} <= {cell.style for cell in cells}


def test_marks_lie_as_the_points_do() -> None:
    status = next(s for s in statuses() if s.pictured_k > 100)
    rows = draw(plant_model(), status, 76, 24)
    where = {
        cell.character: (x, y)
        for y, row in enumerate(rows)
        for x, cell in enumerate(row)
        if cell.style in ("centre", "next")
    }
    # The second candidate is larger and B is positive: its centre lies further right and higher.
    assert where["1"][0] > where["0"][0]
    assert where["1"][1] <= where["0"][1]


def test_a_state_outside_every_set_is_still_in_the_picture() -> None:
    status = statuses()[-1].model_copy(update={"pictured_x_next": (50.0, -50.0)})
    rows = draw(plant_model(), status, 40, 12)
    assert rows[0][-1].style != "next"
    assert sum(cell.style == "next" for row in rows for cell in row) == 1


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
    return "".join(sorted(c.character for c in cells if c.style == "centre"))


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
