"""Why a rate is low: the reasons add up, and what is advised does raise it."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from runtime.scenario_file import load_scenario
from runtime.shipped import scenario_file_of
from wyner.advice.rate import long_runs, settled_rate
from wyner.advice.why import FULL, OFTEN, Why, remedies_for, why
from wyner.cli.drawing import plot
from wyner.cli.main import main
from wyner.drawing.design import draw_design


def reasons(scenario: Scenario) -> Why:
    return reasons_of(scenario.model_dump_json(exclude_none=True))


@cache
def reasons_of(text: str) -> Why:
    """Simulated once for all tests that ask for it."""
    scenario = Scenario.model_validate_json(text)
    law = make_law(scenario, cached_design(scenario))
    return why(scenario, long_runs(scenario, law, record=True))


def why_of(data: dict[str, Any]) -> Why:
    return reasons(Scenario.model_validate(data))


def promised(remedy: str) -> float:
    """The share of steps that a line of advice says will make a key."""
    (percent,) = re.findall(r"([\d.]+) of 100 steps make a key", remedy)
    return float(percent) / 100


def shipped(name: str, **control: object) -> Scenario:
    scenario = load_scenario(scenario_file_of(name))
    data = scenario.model_dump(mode="json", exclude_none=True)
    data["control"].update(control)
    return Scenario.model_validate(data)


@pytest.mark.parametrize("name", ["paper", "sustained", "double-integrator"])
def test_the_shares_add_up(name: str) -> None:
    found = reasons(shipped(name))
    assert (
        found.agreed.value + found.several.value + found.none.value + found.beyond.value
        == pytest.approx(1.0)
    )
    assert found.as_json()["remedies"] == found.remedies


def test_the_paper_law_is_quiet_because_its_candidates_are_one() -> None:
    found = reasons(shipped("paper"))
    assert found.equal.value > 0.99
    assert found.agreed.value == 0
    assert found.remedies[0].startswith('control.law = "sustained"')
    assert reasons(shipped("paper", law="sustained")).agreed.value > 0.2


@pytest.mark.long
def test_a_softer_regulator_raises_the_rate_where_it_is_advised() -> None:
    """And by as much as the line says."""
    stiff = reasons(shipped("double-integrator"))
    assert stiff.agreed.value == 0
    (remedy,) = [r for r in stiff.remedies if "control.regulator.input = [10.0]" in r]
    soft = reasons(
        shipped("double-integrator", regulator={"next_state": [1.0, 1.0], "input": [10.0]})
    )
    assert soft.agreed.value == pytest.approx(promised(remedy), abs=0.03)
    assert promised(remedy) > 0.3
    assert all(line.startswith("to keep it talking: ") for line in stiff.lines()[6:])


MOTORS = {
    "two states": ("[[0, 1], [0, -2]]", "[[0], [1]]", "0.1"),
    # Position, speed and current of a textbook's motor.
    "three states": ("[[0, 1, 0], [0, -10, 1], [0, -0.02, -2]]", "[[0], [0], [2]]", "0.05"),
}


def followed(scenario: Scenario, remedy: str) -> Scenario:
    """The scenario after the line was followed, word by word."""
    data = scenario.model_dump(mode="json", exclude_none=True)
    if remedy.startswith("control.regulator.input = "):
        weights = remedy.removeprefix("control.regulator.input = ").partition(":")[0]
        data["control"]["regulator"]["input"] = json.loads(weights)
    elif remedy.startswith('control.law = "packed", with one table [[control.costs]]'):
        data["control"] |= {"law": "packed", "costs": data["control"]["costs"][:1]}
    else:
        raise AssertionError(f"a remedy that nobody has followed: {remedy}")
    return Scenario.model_validate(data)


@pytest.mark.long
@pytest.mark.parametrize("name", [*MOTORS, "sustained"])
def test_each_line_of_advice_raises_the_rate_when_it_is_followed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in MOTORS:
        A, B, period = MOTORS[name]
        path = tmp_path / "own.toml"
        monkeypatch.chdir(tmp_path)
        assert main(["new", "own", "--A", A, "--B", B, "--period", period, "--continuous"]) == 0
        # few sets are enough: the rate is that of the loop near the origin
        path.write_text(path.read_text().replace("horizon = 30", "horizon = 5"))
        scenario = load_scenario(path)
    else:
        scenario = shipped(name)
    before = reasons(scenario)
    assert before.remedies
    for remedy in before.remedies:
        after = reasons(followed(scenario, remedy)).agreed.value
        assert after > before.agreed.value + 0.02, (remedy, before.agreed.value, after)
        assert after == pytest.approx(promised(remedy), abs=0.03)


def test_what_does_not_help_is_not_advised() -> None:
    """No two inputs that the law packed could tell apart fit into the smaller U."""
    for bound, helps in ((20.0, True), (0.1, False)):
        scenario = shipped("sustained", inputs={"half_widths": [bound]})
        shares = dict.fromkeys(("equal", "several", "none", "beyond", "saturated"), 0.0)
        advised = remedies_for(scenario, shares | {"agreed": 0.3})
        packed = [promised(line) for line in advised if '"packed"' in line]
        assert [share > 0.9 for share in packed] == [True] * helps


def test_a_full_rate_needs_no_advice() -> None:
    found = reasons(load_scenario(scenario_file_of("packed")))
    assert found.agreed.value > FULL
    assert found.remedies == ()
    assert len(found.lines()) == 6
    assert "to raise the rate: x" in replace(found, remedies=("x",)).lines()


@pytest.mark.long
def test_a_small_alpha_is_named() -> None:
    scenario = shipped("batch-reactor")
    tight = scenario.model_copy(
        update={"secrecy": scenario.secrecy.model_copy(update={"alpha": 1.05})}
    )
    found = reasons(tight)
    assert found.beyond.value > found.agreed.value
    shares = (found.agreed, found.several, found.none, found.beyond)
    assert sum(share.value for share in shares) == pytest.approx(1.0)
    assert any("secrecy.alpha" in remedy for remedy in found.remedies)


@pytest.mark.long
def test_the_design_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "sustained.png"
    assert main(["design", "sustained", "--plot", str(path)]) == 0
    assert path.stat().st_size > 10_000
    assert main(["design", "sustained", "--plot", str(tmp_path / "a.txt")]) == 2


def test_a_design_in_four_dimensions_is_drawn(tmp_path: Path) -> None:
    scenario = shipped("quadruple-tank")
    design = cached_design(scenario)
    law = make_law(scenario, design)
    path = tmp_path / "quadruple-tank.pdf"
    plot(str(path), (9.0, 4.2), lambda figure: draw_design(figure, scenario, design, law))
    assert path.stat().st_size > 10_000


def test_the_corners_of_the_test_set_are_inside_as_the_ends_have_it() -> None:
    """The advice counts with the agreement's tolerance: half the corners round to above 1."""
    data = shipped("packed").model_dump(mode="json", exclude_none=True)
    data["plant"]["disturbance"] |= {
        "kind": "corners",
        "half_widths": data["defender"]["disturbance"]["half_widths"],
    }
    scenario = Scenario.model_validate(data)
    law = make_law(scenario, cached_design(scenario))
    runs = long_runs(scenario, law, record=True)
    found = why(scenario, runs)
    assert found.none.value == 0
    assert found.agreed.value == pytest.approx(settled_rate(runs).settled.agreed.value, abs=0.02)
    assert found.remedies == ()


def test_steps_that_leave_the_test_set_are_counted() -> None:
    data = shipped("packed").model_dump(mode="json", exclude_none=True)
    assert why_of(data).left.value == 0
    widths = data["defender"]["disturbance"]["half_widths"]
    data["plant"]["disturbance"] = {"kind": "gaussian", "half_widths": widths, "deviation": 0.5}
    found = why_of(data)
    both_inside = 0.9545 ** len(widths)  # two standard deviations, each state by itself
    assert found.left.value == pytest.approx(1 - both_inside, abs=0.01)
    assert any(
        "of 100 steps leave D_c: a key that is made there may be" in w for w in found.lines()
    )


def test_advice_names_the_gain_where_the_file_states_one() -> None:
    found = reasons(shipped("double-integrator"))
    assert found.equal.value > OFTEN
    data = shipped("double-integrator").model_dump(mode="json", exclude_none=True)
    stated = Scenario.model_validate(data)
    gain = cached_design(stated).K.tolist()
    del data["control"]["regulator"]
    data["control"]["gain"] = gain
    by_gain = Scenario.model_validate(data)
    shares = {"agreed": 0.1, "equal": 0.9, "several": 0.9, "none": 0.0, "beyond": 0.0}
    for scenario, named in (
        (stated, "control.regulator.input = [10.0]"),
        (by_gain, "control.gain"),
    ):
        advised = "; ".join(remedies_for(scenario, shares | {"saturated": 0.0}))
        assert named in advised
        assert ("control.gain" in advised) == (scenario is by_gain)
