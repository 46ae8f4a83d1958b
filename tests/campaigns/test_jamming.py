"""A short form of the relay that jams, and a rule that it finds broken."""

import pytest

from controller_service import alarms
from protocol.link.session import rules_of
from runtime.scenario_file import scenario_of
from tests.campaigns import jamming
from tests.campaigns.jamming import MIXED, STRATEGIES, UNDER_WAY, Found, Strategy
from tests.support.broken import broken
from tests.support.size import size

MOST = rules_of(scenario_of("watched")).watch.burst + UNDER_WAY


def run(strategy: Strategy) -> Found:
    return jamming.jammed(1, strategy, onset=200, steps=size(700, 2500))


@pytest.mark.long
@pytest.mark.parametrize("name", [*STRATEGIES, *MIXED])
def test_no_relay_makes_the_loop_run_unwatched_without_an_alarm(name: str) -> None:
    found = run((STRATEGIES | MIXED)[name])
    assert found.watched > 50
    assert found.excess <= MOST


def test_who_ends_each_session_at_its_first_step_is_alarmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """None of those steps was ever counted: 500 in a row went unwatched without an alarm."""
    found = run(jamming.end_each_session_uncounted)
    assert found.excess <= MOST
    assert found.alarms["unwatched"] >= 2
    broken(
        monkeypatch,
        alarms,
        "rules.watch.unheard(record.unwatched)",
        "record.unwatched",
    )
    assert run(jamming.end_each_session_uncounted).excess > MOST


@pytest.mark.long
def test_an_honest_loop_under_losses_and_deaths_makes_no_alarm() -> None:
    found = [jamming.honest(seed, 600) for seed in range(size(4, 20))]
    assert sum(one.crashes for one in found) > 0
    assert sum(one.watched for one in found) > 1000
    assert not [one.alarms for one in found if one.alarms]
