"""Why a rate is low: the reasons add up, and what is advised does raise it."""

from dataclasses import replace
from pathlib import Path

import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario, load_scenario
from protocol.shipped import scenario_file_of
from wyner.studies.why import FULL, Why, why


def reasons(scenario: Scenario) -> Why:
    return why(scenario, make_law(scenario, cached_design(scenario)))


def shipped(name: str, **control: object) -> Scenario:
    scenario = load_scenario(scenario_file_of(name))
    data = scenario.model_dump(mode="json", exclude_none=True)
    data["control"].update(control)
    return Scenario.model_validate(data)


@pytest.mark.parametrize("name", ["paper", "sustained", "double-integrator", "batch-reactor"])
def test_the_shares_add_up(name: str) -> None:
    found = reasons(shipped(name))
    assert found.agreed + found.several + found.none + found.beyond == pytest.approx(1.0)
    assert found.as_json()["remedies"] == found.remedies


def test_the_paper_law_is_quiet_because_its_candidates_are_one() -> None:
    found = reasons(shipped("paper"))
    assert found.equal > 0.99
    assert found.agreed == 0
    assert found.remedies[0].startswith('control.law = "sustained"')
    assert reasons(shipped("paper", law="sustained")).agreed > 0.2


def test_a_softer_regulator_raises_the_rate_where_it_is_advised() -> None:
    stiff = reasons(shipped("double-integrator"))
    assert any("control.regulator.input" in remedy for remedy in stiff.remedies)
    soft = reasons(
        shipped("double-integrator", regulator={"next_state": [1.0, 1.0], "input": [10.0]})
    )
    assert soft.agreed > stiff.agreed + 0.05


def test_a_full_rate_needs_no_advice() -> None:
    found = reasons(load_scenario(scenario_file_of("packed")))
    assert found.agreed > FULL
    assert found.remedies == ()
    assert len(found.lines()) == 2
    assert "to raise the rate: x" in replace(found, remedies=("x",)).lines()


def test_a_small_alpha_is_named() -> None:
    scenario = shipped("batch-reactor")
    tight = scenario.model_copy(
        update={"secrecy": scenario.secrecy.model_copy(update={"alpha": 1.05})}
    )
    found = reasons(tight)
    assert found.beyond > found.agreed
    assert any("secrecy.alpha" in remedy for remedy in found.remedies)


def test_the_design_is_drawn(tmp_path: Path) -> None:
    from wyner.cli.main import main

    for name in ("sustained", "quadruple-tank"):
        for kind in ("png", "pdf"):
            path = tmp_path / f"{name}.{kind}"
            assert main(["design", name, "--plot", str(path)]) == 0
            assert path.stat().st_size > 10_000
    assert main(["design", "sustained", "--plot", str(tmp_path / "a.txt")]) == 2
