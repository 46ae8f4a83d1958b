"""An attack where it stands: what it is told, and what comes of one that fails."""

import logging
from pathlib import Path
from typing import Any, TypeVar

import pytest

from attacker_service.attacker import Attacker
from plant_service.plant import Disturbances, FilteredPlant, LinearModel
from protocol.messages import Measurement, Offer
from protocol.scenario import AttackTable, Scenario
from runtime.chance import noise
from runtime.errors import UsageError
from runtime.scenario_file import attack_option, scenario_of

pytestmark = pytest.mark.slow

OWN = Path(__file__).with_name("spoilt.py")
M = TypeVar("M", Measurement, Offer)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return scenario_of("packed")


def attacked(scenario: Scenario, attack: AttackTable) -> FilteredPlant:
    plant = LinearModel(scenario, Disturbances(scenario, noise(1, 2)))
    return FilteredPlant(plant, [Attacker(scenario, attack, 1)], scenario.initial_state)


def one(plant: FilteredPlant, k: int) -> tuple[float, ...]:
    """What is reported of a step under no input."""
    plant.begin(k, (), (0.0,))
    return plant.end(k)


def test_before_the_onset_the_truth_passes_and_then_the_attack(scenario: Scenario) -> None:
    plant = attacked(scenario, AttackTable(kind=f"{OWN}:Frozen", onset=3))
    truths = []
    for k in range(5):
        said = one(plant, k)
        assert plant.truth is not None
        truths.append((said == plant.truth.x_next, said))
    assert [same for same, _ in truths] == [True, True, False, False, False]
    assert truths[1][1] == truths[2][1] == truths[4][1]
    assert plant.close() == ""


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("Raises", "RuntimeError: out of ideas"),
        ("Short", "], expected 2 finite numbers"),
        ("Nan", "got [[nan, nan]], expected 2 finite numbers"),
    ],
)
def test_one_that_fails_is_a_line_and_the_truth_passes(
    name: str,
    why: str,
    scenario: Scenario,
    caplog: pytest.LogCaptureFixture,
) -> None:
    plant = attacked(scenario, AttackTable(kind=f"{OWN}:{name}", onset=2))
    logging.getLogger("attacker").propagate = True
    with caplog.at_level(logging.ERROR):
        failed = []
        for k in range(4):
            said = one(plant, k)
            assert plant.truth is not None
            assert said == plant.truth.x_next
            failed.append(plant.truth.failed)
    assert failed[0] == failed[2] == failed[3] == ""
    assert why in failed[1]
    assert "\n" not in failed[1]
    plant.close()


def test_a_stuck_actuator_is_labelled_and_its_reading_is_true(scenario: Scenario) -> None:
    plant = attacked(
        scenario, AttackTable.model_validate({"kind": "stuck", "onset": 1, "value": [2.0]})
    )
    plant.begin(0, (), (1.0,))
    plant.end(0)
    assert plant.truth is not None
    assert plant.truth.u == (1.0,)
    plant.begin(1, (), (1.0,))
    assert plant.end(1) == plant.truth.x_next
    assert plant.truth.u == (2.0,)
    plant.close()


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ({"kind": "gost"}, "attack.kind: got 'gost', expected ghost, replay"),
        ({"kind": "ghost", "knows": ["coins"]}, "attack.knows: ghost needs 'bus' and 'model'"),
        ({"kind": "ghost", "at": "bus"}, "attack.at: got 'bus', expected 'sensor': ghost"),
        ({"kind": "ghost", "shares": 1}, "attack.shares: got 1, "),
        ({"kind": "nowhere.py:X"}, "attack.kind: nowhere.py: no such file"),
        ({"kind": f"{OWN}:Observation"}, "attack.kind: got "),
    ],
)
def test_what_cannot_be_made_is_one_line(
    table: dict[str, Any], line: str, scenario: Scenario
) -> None:
    with pytest.raises(UsageError) as caught:
        Attacker(scenario, AttackTable.model_validate({"onset": 5, **table}), 1)
    assert len(caught.value.problems) == 1
    assert caught.value.problems[0].startswith(line), caught.value.problems


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ghost", "--attack: got 'ghost', expected KIND@ONSET"),
        ("ghost@x", "--attack: got 'ghost@x', expected KIND@ONSET"),
        ("ghost@0", "--attack: onset: got 0, expected greater"),
        ("ghost@9", "--attack: got onset 9, expected one below --steps 9"),
        ("ghost@3,share", "--attack: got 'share', expected NAME=VALUE"),
    ],
)
def test_a_wrong_option_is_one_line(text: str, expected: str) -> None:
    with pytest.raises(UsageError) as caught:
        attack_option(text, None, 9)
    assert caught.value.problems[0].startswith(expected)


COVERT = AttackTable.model_validate({"kind": "covert", "onset": 2, "input": 0.3})
OFFER = Offer(session="0" * 16, k=2, candidates=((0.0,), (1.0,), (2.0,), (3.0,)), cipher=0)


def passed(attacker: Attacker, message: M) -> M:
    """The message as it comes out at the other end."""
    kind = type(message)
    return kind.model_validate_json(attacker.incoming(kind, message.wire()))


def test_on_the_bus_both_ways_are_rewritten_and_a_repeated_message_alike(
    scenario: Scenario,
) -> None:
    attacker = Attacker(scenario, COVERT, 1)
    got = passed(attacker, OFFER)
    assert [u[0] for u in got.candidates] == pytest.approx([0.3, 1.3, 2.3, 3.3])
    assert passed(attacker, OFFER) == got
    x = (1.0, 1.0)
    m = Measurement(session="0" * 16, k=3, x=x, applied_k=2, x_after=x)
    said = passed(attacker, m)
    assert said.x == said.x_after == pytest.approx((1 - 0.3 * 0.0246, 1 - 0.3 * 0.4877))
    assert passed(attacker, m) == said
    later = m.model_copy(update={"k": 4, "x": (0.0, 0.0)})
    assert passed(attacker, later).x_after == said.x, "the same state is said alike"


JUNK = (
    b"",
    b"{",
    b"\xff" * 100,
    b"[" * 70_000,
    b'{"schema":2,"session":"%s","k":1,"candidates":[[1]],"cipher":0}' % (b"0" * 16),
)


def test_junk_on_the_bus_costs_an_attack_nothing(scenario: Scenario) -> None:
    attacker = Attacker(scenario, COVERT, 1)
    junk = [*JUNK, OFFER.model_copy(update={"candidates": ((1.0, 2.0),)}).wire()]
    for kind in (Measurement, Offer):
        for payload in junk:
            assert attacker.incoming(kind, payload) == payload, "it goes on as it came"
    got = passed(attacker, OFFER)
    assert [u[0] for u in got.candidates] == pytest.approx([0.3, 1.3, 2.3, 3.3])
