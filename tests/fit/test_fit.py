"""A fit from readings alone: the model, the certificate, what the scheme makes of it."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_service.laws import registry
from protocol.scenario import Scenario, ScenarioError, parse_scenario
from tests.support.bare_figures import bare_figures
from wyner.cli.main import main
from wyner.fit.conformal import violation_bound
from wyner.fit.fitting import fit
from wyner.fit.identification import FitError
from wyner.fit.plan import Plan
from wyner.fit.toml import as_toml

CART: dict[str, Any] = {
    "name": "cart",
    "plant": {
        "kind": "ode",
        "object": "cart.py:dynamics",
        "period_s": 0.1,
        "initial_state": [0.0, 0.0],
        "disturbance": {"half_widths": [0.002, 0.01]},
    },
    "control": {
        "law": "packed",
        "horizon": 5,
        "gain": [[-1.0, -1.5]],
        "inputs": {"half_widths": [2.0]},
    },
    "secrecy": {"alpha": 8.0, "candidates": 2},
}
DYNAMICS = """
def dynamics(t, x, u):
    return x[1], 2.0 * u[0] - 0.8 * x[1] * abs(x[1]) - 0.2 * x[1]
"""
PLAN = Plan(sessions=40, steps=60, seed=2)

Fitted = tuple[dict[str, Any], Scenario]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cart")
    (path / "cart.py").write_text(DYNAMICS)
    (path / "cart.toml").write_text(as_toml(CART, "A cart with air drag."))
    return path


@pytest.fixture(scope="module")
def cart(folder: Path) -> Fitted:
    return fit(CART, folder / "cart.toml", PLAN, 0.05)


def test_the_model_is_the_plants_about_its_range(cart: Fitted) -> None:
    _, scenario = cart
    assert np.array(scenario.A) == pytest.approx(np.array([[1.0, 0.1], [0.0, 0.96]]), abs=0.06)
    assert np.array(scenario.B) == pytest.approx(np.array([[0.01], [0.2]]), abs=0.02)


def test_the_certificate_is_of_the_law_that_it_names(cart: Fitted) -> None:
    tables, scenario = cart
    c = scenario.defender.calibration
    assert c is not None
    assert (c.sessions, c.steps) == (40, 60)
    assert c.violation == violation_bound(40, c.exceeded)
    assert c.law_fingerprint == scenario.law_fingerprint()
    assert tables["defender"]["calibration"] == c.model_dump()


def test_the_file_is_the_scenario(cart: Fitted) -> None:
    tables, scenario = cart
    text = as_toml(tables, "Two\nlines.")
    assert text.startswith("# Two\n# lines.\n")
    assert parse_scenario(tomllib.loads(text), "again.toml") == scenario


def test_the_command_writes_it_and_computes_no_set_a_second_time(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder / "fitted.toml"
    plan = ["--sessions=20", "--steps=30"]
    assert main(["fit", str(folder / "cart.toml"), "-o", str(out), *plan]) == 0
    told = capsys.readouterr()
    lines = told.out.replace("\n  ", " ")
    assert "of 20 fresh sessions did" in lines
    assert f"wrote {out}" in lines
    assert "identified A and B from 400 steps" in told.err
    with monkeypatch.context() as again:
        again.setattr(registry, "synthesise", None)
        assert main(["fit", str(folder / "cart.toml"), "-o", str(out), "--json", *plan]) == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(found) == ["calibration", "half_widths", "no_interval", "output", "seed"]
    assert list(bare_figures(found)) == []
    assert (found["output"], found["calibration"]["sessions"]) == (str(out), 20)
    assert main(["design", str(out)]) == 0
    lines = capsys.readouterr().out.replace("\n  ", " ")
    assert "D_c: a session of 30 steps leaves it with probability at most" in lines


def test_what_cannot_be_fitted_says_why(folder: Path) -> None:
    def without(*path: str) -> dict[str, Any]:
        tables = {k: dict(v) if isinstance(v, dict) else v for k, v in CART.items()}
        place = tables
        for name in path[:-1]:
            place = place[name]
        del place[path[-1]]
        return tables

    with pytest.raises(ScenarioError, match=r"plant.operating_point.state and control.inputs: exp"):
        fit(without("plant", "initial_state"), folder / "cart.toml", PLAN, 0.05)
    still = Plan(sessions=5, excite_steps=2)
    with pytest.raises(FitError, match="got 2 transitions, expected more than 3"):
        fit(CART, folder / "cart.toml", still, 0.05)


# --- what is no plant to fit ----------------------------------------------------------------------

OWN = """
import random

class Plant:
    NOISE, B = 0.0, ((0.005,), (0.1,))

    def reset(self, seed):
        self.draw, self.x = random.Random(seed), [0.0, 0.0]
        return self.x

    def step(self, u, period_s):
        a, b = self.x
        moved = [a + 0.1 * b, 0.9 * b]
        self.x = [
            v + sum(p * w for p, w in zip(row, u)) + self.NOISE * self.draw.uniform(-1, 1)
            for v, row in zip(moved, self.B)
        ]
        return self.x

class Dead(Plant):
    NOISE, B = 0.01, ((0.0,), (0.0,))

class DeadAndStill(Plant):
    B = ((0.0,), (0.0,))

class OneOfTwo(Plant):
    NOISE, B = 0.01, ((0.005, 0.0), (0.1, 0.0))
"""


@pytest.mark.parametrize(
    ("name", "inputs", "says"),
    [
        ("Dead", 1, "input u_1 has no effect: B's column is within its error"),
        ("OneOfTwo", 2, "input u_2 has no effect: B's column is within its error"),
        ("DeadAndStill", 1, "state x_1 is zero throughout: no input has an effect on it"),
        ("Plant", 1, "the plant shows no disturbance: the model leaves nothing but rounding"),
    ],
)
def test_a_plant_without_an_input_or_a_disturbance_is_named(
    name: str, inputs: int, says: str, tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(OWN)
    tables = {
        **CART,
        "plant": {
            "kind": "python",
            "object": f"own.py:{name}",
            "period_s": 0.1,
            "operating_point": {"state": [0.0, 0.0], "input": [0.0] * inputs},
            "disturbance": {"enters": "none"},
        },
        "control": {"law": "packed", "horizon": 5, "inputs": {"half_widths": [2.0] * inputs}},
    }
    with pytest.raises(FitError) as raised:
        fit(tables, tmp_path / "own.toml", PLAN, 0.05)
    assert str(raised.value).startswith(says)
    assert "\n" not in str(raised.value)


def test_the_steps_that_a_network_misses_count_with_the_fallbacks_input() -> None:
    """A linear plant whose D is known: the fitted D_c is about it, missed steps and all."""
    tables = {
        **CART,
        "plant": {
            "A": [[1.0, 0.1], [0.0, 0.9]],
            "B": [[0.005], [0.1]],
            "period_s": 0.1,
            "initial_state": [0.0, 0.0],
            "disturbance": {"half_widths": [0.002, 0.01]},
        },
        "control": {**CART["control"], "gain": [[-3.0, -2.0]], "inputs": {"half_widths": [4.0]}},
        "link": {"fallback": "zero"},
        "network": {"to_plant": {"loss": 0.5}},
    }
    _, scenario = fit(tables, Path("net.toml"), PLAN, 0.05)
    widths = scenario.defender.disturbance.half_widths
    assert widths == pytest.approx((0.002, 0.01), rel=0.1)
