"""A fitted D_c live: an honest step may leave it, and only r failures of s tests are an alarm."""

from pathlib import Path

import pytest

from controller_service.command import designed
from protocol.agreement import INSIDE
from protocol.scenario import Attack, Scenario, parse_scenario
from runtime.recording import TraceReader
from runtime.run_folder import CONTROLLER_TRACE
from runtime.scenario_file import scenario_of
from tests.attacker.live_runs import run
from tests.support.traces import Resolved

pytestmark = pytest.mark.slow

ONSET = 200


def fitted() -> Scenario:
    """D reaches 5 % beyond D_c, of which it is promised that 0.0098 of the sessions leave it."""
    tables = scenario_of("packed").model_dump(mode="json", exclude_unset=True)
    widths = tables["defender"]["disturbance"]["half_widths"]
    tables["plant"]["disturbance"] = {
        "half_widths": [1.05 * w for w in widths],
        "may_leave_defender_set": True,
    }
    tables["defence"] = {"false_alarms_a_day": 0.02}
    tables["defender"]["calibration"] = {
        "sessions": 300,
        "steps": 200,
        "exceeded": 0,
        "violation": 0.0098,
        "confidence": 0.95,
        "law_fingerprint": parse_scenario(tables, "fitted").law_fingerprint(),
    }
    return parse_scenario(tables, "fitted")


def test_two_failures_of_six_are_an_alarm_and_one_is_none(tmp_path: Path) -> None:
    scenario = fitted()
    rule = scenario.defence.rule(scenario.defender.calibration, 0.1, 4)
    assert rule == (2, 6)
    law = designed(scenario_of("packed"))
    run(scenario, law, ONSET + 60, tmp_path, Attack(kind="stuck", onset=ONSET))
    told = list(Resolved(TraceReader(tmp_path / CONTROLLER_TRACE).lines()))
    steps = [e for e in told if e["event"] == "transition"]
    assert [e["k"] for e in steps] == list(range(ONSET + 60))
    failed = [min(e["gauges"]) > INSIDE for e in steps]
    expected = [k for k, one in enumerate(failed) if one and sum(failed[max(0, k - 5) : k + 1]) > 1]
    assert [e["k"] for e in told if e["event"] == "alarm"] == expected
    assert 0 < sum(failed[:ONSET]) > sum(k < ONSET for k in expected), "no honest failure is spared"
    assert any(k >= ONSET for k in expected), "the attack is not seen"
