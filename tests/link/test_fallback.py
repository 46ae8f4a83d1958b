"""What a missed step applies: it is in U, and the check finds it again to the last bit."""

import math
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import Gauge
from protocol.link.fallback import Fallback, clip
from protocol.vectors import Vector
from runtime.scenario_file import scenario_of

BOX = Gauge(half_widths=(1.0, 2.0, 0.5))
SLAB = Gauge(H=((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)), h=(2.0, 2.0, 4.0, 4.0))
NUMBERS = st.floats(-8, 8)


@given(st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_in_a_box_each_component_goes_to_the_nearest(u: tuple[float, ...]) -> None:
    expected = []
    for v, w in zip(u, (1.0, 2.0, 0.5), strict=True):
        expected.append(v if abs(v) <= w else math.copysign(w, v))
    assert clip(u, BOX) == tuple(expected)


@given(st.tuples(NUMBERS, NUMBERS))
def test_in_another_set_a_vector_is_made_shorter_and_no_shorter_than_needed(
    u: tuple[float, ...],
) -> None:
    clipped = clip(list(u), SLAB)
    assert isinstance(clipped, tuple)
    if SLAB(u) <= 1:
        assert clipped == u
    else:
        assert SLAB(clipped) == pytest.approx(1)
        assert clipped[0] * u[1] == pytest.approx(clipped[1] * u[0], abs=1e-9)
        assert clipped[0] * u[0] + clipped[1] * u[1] > 0


GAIN = ((-4.0, -1.0, 0.5), (0.25, 2.0, -3.0))
X = (1.0, 0.5, 3.0)


@pytest.mark.parametrize(
    ("kind", "width", "expected"),
    [
        ("hold", 0.1, (9.0, 7.0)),
        ("zero", 0.1, (0.0, 0.0)),
        ("regulator", 100.0, (-3.0, -7.75)),
        ("regulator", 5.0, (-3.0, -5.0)),
    ],
)
def test_three_kinds(
    kind: Literal["hold", "zero", "regulator"], width: float, expected: Vector
) -> None:
    """K x = (-4 - 0.5 + 1.5, 0.25 + 1 - 9); the input in force is applied as it is."""
    fallback = Fallback(kind, Gauge(half_widths=(width, width)), GAIN)
    assert fallback.input(X, (9.0, 7.0)) == expected


def test_a_scenarios_fallback_has_its_gain_and_its_u() -> None:
    scenario = scenario_of("motor")
    fallback = Fallback.of(scenario)
    (largest,) = fallback.inputs.half_widths or ()
    assert fallback.kind == "regulator"
    assert fallback.gain == scenario.control.gain == ((-1.0, -0.5),)
    assert fallback.inputs((largest,)) == 1
    assert fallback.input((1e6, 0.0), (0.0,)) == (-largest,)
    assert Fallback.of(scenario_of("sustained")).kind == "zero"
