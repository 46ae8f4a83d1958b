"""The table `[defence]`: what it says, what it lacks, and what it changes."""

import tomllib
from typing import Any

import pytest

from protocol.defence.alarm_rule import AT_ONCE, AlarmRule
from protocol.link.session import rules_of
from protocol.scenario import Scenario, ScenarioError, parse_scenario
from tests.support.scenarios import text_of


def tables(name: str) -> dict[str, Any]:
    return tomllib.loads(text_of(name))


def made(of: dict[str, Any]) -> Scenario:
    return parse_scenario(of, "file.toml")


def refused(changed: dict[str, Any]) -> str:
    with pytest.raises(ScenarioError) as caught:
        made(changed)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_keyed_coin_needs_keys() -> None:
    changed = tables("watched")
    del changed["keys"]
    assert "takes distilled keys, expected a table [keys] beside it" in refused(changed)
    changed["keys"] = {"eps_E": 0.0}
    with pytest.raises(
        ScenarioError, match=r"defence.coin: 'keys' takes distilled keys, and eps_E = 0"
    ):
        made(changed)


def test_a_sealed_symbol_needs_keys() -> None:
    changed = tables("sealed")
    del changed["keys"]
    assert "takes distilled keys, expected a table [keys] beside it" in refused(changed)


def test_a_keyed_coin_needs_candidates_that_every_step_tells_apart() -> None:
    changed = tables("watched")
    changed["control"]["alphabet"] = {"spacing": 1.9}
    assert (
        "control.alphabet.spacing = 1.9 does not tell candidates apart in every step, "
        "expected 2 or more"
    ) in refused(changed)
    changed["control"]["alphabet"] = {"spacing": 2.0}
    assert made(changed).defence.keyed
    for law in ("sustained", "paper"):
        changed = tables(law)
        changed |= {"keys": {"eps_E": 0.3}, "defence": {"coin": "keys"}}
        assert (
            f"control.law = '{law}' does not keep its candidates apart, expected 'packed'"
        ) in refused(changed)
        del changed["defence"]
        assert made(changed).keys is not None


def test_a_safe_alarm_needs_a_watchdog() -> None:
    changed = tables("watched")
    changed["defence"]["on_alarm"] = "safe"
    assert "defence.on_alarm: safe ends the offers" in refused(changed)
    changed["link"]["watchdog_s"] = 2.0
    assert rules_of(made(changed)).halts


def test_no_rule_of_alarms_keeps_to_any_rate() -> None:
    changed = tables("motor")
    changed["defender"]["calibration"] |= {"steps": 2, "violation": 0.9}
    assert "defence.false_alarms_a_day: got 0.01, which no rule" in refused(changed)


def test_who_keys_the_coin_and_who_does_not_have_other_models() -> None:
    keyed = made(tables("watched"))
    changed = tables("watched")
    del changed["defence"]
    private = made(changed)
    assert keyed.fingerprint() != private.fingerprint()
    assert keyed.loop_fingerprint() != private.loop_fingerprint()
    changed["defence"] = {"coin": "private"}
    same = made(changed)
    assert (same.fingerprint(), same.loop_fingerprint()) == (
        private.fingerprint(),
        private.loop_fingerprint(),
    )


def test_a_fitted_set_alarms_on_several_failures_and_a_given_one_on_the_first() -> None:
    assert made(tables("watched")).alarm_rule == AT_ONCE
    motor = made(tables("motor")).alarm_rule
    assert motor.failures > 1
    assert motor.window > motor.failures


@pytest.mark.parametrize(
    ("rule", "failed", "alarms"),
    [
        (AlarmRule(), [1, 0, 1, 1], [1, 0, 1, 1]),
        (AlarmRule(2, 3), [1, 0, 1, 0, 0, 1, 1], [0, 0, 1, 0, 0, 0, 1]),
        (AlarmRule(2, 2), [1, 0, 1, 1, 1], [0, 0, 0, 1, 1]),
    ],
)
def test_an_alarm_is_of_a_test_that_failed(
    rule: AlarmRule, failed: list[int], alarms: list[int]
) -> None:
    found, before = [], 0
    for one in failed:
        alarm, before = rule.test(before, failed=bool(one))
        found.append(int(alarm))
    assert found == alarms
