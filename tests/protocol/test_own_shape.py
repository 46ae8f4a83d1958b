"""A D_e of its own shape: equation (11) asks that it contains D_c, and no more."""

import pytest

from protocol.scenario import Scenario, ScenarioError
from tests.support.scenarios import changed


def with_shape(disturbance: object, alpha: float = 1.0, name: str = "packed") -> Scenario:
    return changed(name, secrecy={"alpha": alpha, "disturbance": disturbance})


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
