"""A fitted D_c live: an honest step may leave it, and only r failures of s tests are an alarm."""

from pathlib import Path

import pytest

from protocol.agreement import INSIDE
from protocol.scenario import Attack
from runtime.run_folder import CONTROLLER_TRACE
from runtime.scenario_file import scenario_of
from tests.support.recorded_pair import RecordedPair
from tests.support.traces import read_trace

pytestmark = pytest.mark.slow

ONSET = 200


def test_two_failures_of_six_are_an_alarm_and_one_is_none(tmp_path: Path) -> None:
    """D reaches 5 % beyond D_c, of which it is promised that 0.0098 of the sessions leave it."""
    law = scenario_of("packed").law_fingerprint()
    wide = """half_widths = [0.126, 0.126]
may_leave_defender_set = true"""
    promise = f"""
[defence]
false_alarms_a_day = 0.02

[defender.calibration]
sessions = 300
steps = 200
exceeded = 0
violation = 0.0098
confidence = 0.95
law_fingerprint = "{law}"
"""
    loop = RecordedPair(
        tmp_path,
        name="packed",
        more=promise,
        changes=(("half_widths = [0.1, 0.1]", wide),),
        attack=Attack(kind="stuck", onset=ONSET),
    )
    scenario = loop.scenario
    assert scenario.defence.rule(scenario.defender.calibration, 0.1, 4) == (2, 6)
    loop.run(lambda: loop.plant.state.link.k >= ONSET + 60)
    loop.stop()
    told = read_trace(tmp_path / CONTROLLER_TRACE).events
    steps = [e for e in told if e["event"] == "transition"]
    assert [e["k"] for e in steps] == list(range(len(steps)))
    failed = [min(e["gauges"]) > INSIDE for e in steps]
    expected = [k for k, one in enumerate(failed) if one and sum(failed[max(0, k - 5) : k + 1]) > 1]
    assert [e["k"] for e in told if e["event"] == "alarm"] == expected
    assert 0 < sum(failed[:ONSET]) > sum(k < ONSET for k in expected), "no honest failure is spared"
    assert any(k >= ONSET for k in expected), "the attack is not seen"
