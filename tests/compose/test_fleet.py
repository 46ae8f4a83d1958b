"""Many loops in three hosts on one router."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.compose.composition import RUN, Composition, wait_for
from tests.compose.conftest import running

LOOPS = [f"loop-{n:04d}" for n in range(5)]


@pytest.fixture(scope="module")
def fleet(image: str) -> Iterator[Composition]:
    values = {"WYNER_MESSAGE": "to all", "WYNER_LOOPS": str(len(LOOPS)), "WYNER_PACE": "x4"}
    yield from running("wyner-test-fleet", "fleet", **values)


def statuses(system: Composition, vantage: str) -> dict[str, dict[str, Any]]:
    """The newest status of each loop, from one side."""
    program = "import json, pathlib\n" + (
        "print(json.dumps({p.parts[-3]: json.loads(p.read_bytes()) for p in "
        f"pathlib.Path('{RUN}').glob('loop-*/{vantage}/status.json')}}))"
    )
    found: dict[str, dict[str, Any]] = json.loads(system.python(f"fleet-{vantage}", program).stdout)
    return found


def messages(system: Composition) -> dict[str, object]:
    """How many messages each plant has recovered."""
    return {loop: status["frame"]["messages"] for loop, status in statuses(system, "plant").items()}


def test_every_message_arrives_on_its_own_loop(fleet: Composition) -> None:
    wait_for(lambda: messages(fleet) == dict.fromkeys(LOOPS, 1), "a message on each loop")
    sessions = {name: s["session"] for name, s in statuses(fleet, "plant").items()}
    assert len(set(sessions.values())) == len(LOOPS)
    assert {n: s["session"] for n, s in statuses(fleet, "controller").items()} == sessions


def test_a_message_reaches_the_loop_it_names_and_no_other(fleet: Composition) -> None:
    name = LOOPS[3]
    fleet.compose("run", "--rm", "--no-deps", "fleet-operator", "send", "to 3", "--loop", name)
    wait_for(lambda: messages(fleet)[name] == 2, f"message on {name}")
    assert messages(fleet) == dict.fromkeys(LOOPS, 1) | {name: 2}
