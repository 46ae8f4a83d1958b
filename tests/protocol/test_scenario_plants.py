"""Scenarios of plants that are no matrices: two disturbance sets, fallbacks, certificates."""

from copy import deepcopy
from typing import Any

import pytest

import wyner  # noqa: F401 - who imports it knows every law and every kind of plant
from protocol.scenario import Scenario, ScenarioError, parse_scenario
from tests.support.scenarios import put

ODE: dict[str, Any] = {
    "name": "pendulum",
    "plant": {
        "kind": "ode",
        "object": "pendulum.py:dynamics",
        "period_s": 0.1,
        "initial_state": [0.1, 0.0],
        "disturbance": {"half_widths": [0.005, 0.02]},
    },
    "defender": {
        "A": [[1.05, 0.1], [1.0, 1.0]],
        "B": [[0.025], [0.5]],
        "disturbance": {"half_widths": [0.006, 0.024]},
    },
    "control": {"horizon": 5, "inputs": {"half_widths": [6.0]}, "gain": [[-4.0, -1.0]]},
    "secrecy": {"alpha": 8.0},
}


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    """The scenario with fields set by path; None takes one out."""
    data = deepcopy(ODE)
    for path, value in changes.items():
        put(data, path, value)
    return data


def scenario(changes: dict[str, Any] | None = None) -> Scenario:
    return parse_scenario(changed(changes or {}), "mine.toml")


FMU = {
    "plant": {
        "kind": "fmu",
        "file": "a.fmu",
        "sha256": "0" * 64,
        "inputs": ["u"],
        "outputs": ["x", "v"],
        "period_s": 0.1,
        "disturbance": {"enters": "none"},
    }
}


def test_the_model_is_the_defenders() -> None:
    s = scenario()
    assert (s.n, s.m) == (2, 1)
    assert s.A == ((1.05, 0.1), (1.0, 1.0))
    assert s.initial_state == (0.1, 0.0)
    assert scenario(FMU).initial_state == (0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"plant.kind": "od"}, 'plant.kind: got "od", expected linear'),
        ({"plant.object": None}, "plant.object: expected here, and not given"),
        (
            {"plant.substeps": 0},
            "plant.substeps: got 0, expected greater",
        ),
        ({"plant.file": "x"}, 'plant.file: got "x", no such field'),
        (
            {"plant.A": [[1.0, 0.0], [0.0, 1.0]]},
            "plant.A: got [[1.0, 0.0], [0.0, 1.0]], expected it under [defender]",
        ),
        ({"defender.A": None}, "defender.A: expected the model's matrix, as a plant of kind 'ode'"),
        ({"plant.initial_state": [0.1]}, "plant.initial_state: got shape 1, expected 2"),
        ({"plant.disturbance.enters": "x"}, 'plant.disturbance.enters: got "x", expected'),
        (
            {"plant.disturbance.enters": "input"},
            "plant.disturbance.half_widths: got shape 2, expected 1",
        ),
        (
            {"plant.operating_point": {"input": [0.0, 0.0]}},
            "plant.operating_point.input: got shape 2, expected 1",
        ),
        (
            {"plant.operating_point": {"input": [0.0], "state_scale": [0.0, 1.0]}},
            "plant.operating_point.state_scale.0: got 0.0, expected greater than 0",
        ),
        ({"plant.limits": [[0.0, 1.0]]}, "plant.limits: got shape 1, expected 2"),
        (
            {"control.disturbance": {"half_widths": [0.005, 0.1]}},
            "control.disturbance: expected a set that contains defender.disturbance",
        ),
        (
            {"control.disturbance": {"half_widths": [0.1]}},
            "control.disturbance: got shape 1, expected 2",
        ),
        (
            {
                "link": {"fallback": "regulator"},
                "control.gain": None,
                "control.regulator": {"next_state": [1.0, 1.0], "input": [1.0]},
            },
            "control.gain: expected a stated gain, as link.fallback = 'regulator'",
        ),
        ({**FMU, "plant": {**FMU["plant"], "sha256": "12"}}, 'plant.sha256: got "12", string'),
        (
            {**FMU, "plant": {**FMU["plant"], "initial_state": [1.0, 2.0]}},
            "plant.initial_state: got [1.0, 2.0], expected none: a plant of this kind",
        ),
    ],
)
def test_a_wrong_field_is_named(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario(changes)
    assert any(f"mine.toml: {says}" in line for line in caught.value.problems), caught.value


def test_the_sets_resist_one_disturbance_and_the_test_asks_for_another() -> None:
    one, two = scenario(), scenario({"control.disturbance": {"half_widths": [0.018, 0.072]}})
    assert one.control_set == one.defender.disturbance
    assert two.control_set.half_widths == (0.018, 0.072)
    assert one.fingerprint() == two.fingerprint()
    assert one.design_fingerprint() != two.design_fingerprint()
    diamond = {"H": [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]], "h": [0.03] * 4}
    polygon = scenario({"control.disturbance": diamond})
    assert polygon.control_set.contains(polygon.defender.disturbance)
    with pytest.raises(ScenarioError, match="expected a set that contains"):
        scenario({"control.disturbance": {**diamond, "h": [0.03, 0.03, 0.03, 0.0299]}})
    round_test = {"disturbance": diamond, "A": ODE["defender"]["A"], "B": ODE["defender"]["B"]}
    for widths, fits in (((0.03, 0.03), True), ((0.03, 0.029), False)):
        changes = {"defender": round_test, "control.disturbance": {"half_widths": widths}}
        if fits:
            assert scenario(changes).control_set.half_widths == widths
        else:
            with pytest.raises(ScenarioError, match="expected a set that contains"):
                scenario(changes)


# --- certificates ---------------------------------------------------------------------------------


def certified(s: Scenario) -> dict[str, Any]:
    return {
        "sessions": 100,
        "steps": 200,
        "exceeded": 0,
        "violation": 0.067,
        "confidence": 0.999,
        "law_fingerprint": s.law_fingerprint(),
    }


def test_a_certificate_is_for_one_law_one_set_and_one_start() -> None:
    table = {"defender.calibration": certified(scenario())}
    s = scenario(table)
    assert s.fingerprint() == scenario().fingerprint()
    for path, value in (
        ("control.law", "paper"),
        ("control.gain", [[-4.1, -1.0]]),
        ("defender.disturbance.half_widths", [0.006, 0.025]),
        ("plant.initial_state", [0.2, 0.0]),
        ("link", {"fallback": "zero"}),
    ):
        with pytest.raises(ScenarioError, match=r"law_fingerprint: .*the certificate is stale"):
            scenario({**table, path: value})
    assert scenario({**table, "secrecy.alpha": 4.0, "description": "other words"})
