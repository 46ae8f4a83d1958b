"""A nonlinear f_c of the user's: what it gives, and what is said where it gives none."""

from pathlib import Path

import pytest

from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from runtime.user_code import ModelError, load_model
from wyner.api import vary

MODEL = "model.py:predict"


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return vary(scenario_of("pendulum"), {"defender.model": MODEL})


def test_a_linear_model_is_nobodys_code(tmp_path: Path) -> None:
    assert load_model(scenario_of("pendulum"), tmp_path) is None


@pytest.mark.parametrize("code", ["(x[0] + u[0], 2)", "[x[0] + u[0], True + 1]"])
def test_a_prediction_is_a_vector_of_floats(code: str, scenario: Scenario, tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text(f"def predict(x, u):\n    return {code}\n")
    predict = load_model(scenario, tmp_path)
    assert predict is not None
    centre = predict((0.1, 0.0), (0.5,))
    assert centre == (0.6, 2.0)
    assert [type(centre), *map(type, centre)] == [tuple, float, float]


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("return (1.0,)", "got [1.0], expected 2 finite numbers"),
        ("return (0.0, float('nan'))", "got [0.0, nan], expected 2 finite numbers"),
        ("return (float('inf'), 0.0)", "got [inf, 0.0], expected 2 finite numbers"),
        ("raise RuntimeError('too\\nfar')", "RuntimeError: too far"),
    ],
)
def test_a_model_without_an_answer_offers_nothing(
    code: str, says: str, scenario: Scenario, tmp_path: Path
) -> None:
    (tmp_path / "model.py").write_text(f"def predict(x, u):\n    {code}\n")
    predict = load_model(scenario, tmp_path)
    assert predict is not None
    with pytest.raises(ModelError) as refused:
        predict((0.1, 0.0), (0.0,))
    assert str(refused.value) == f"defender.model at x = [0.1, 0.0]: {says}"
