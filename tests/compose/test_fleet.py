"""Many loops on one router, each with an id of its own."""

import json
from collections.abc import Iterator

import pytest

from tests.compose.composition import RUN, Composition, docker, leftovers, wait_for

LOOPS = 5


@pytest.fixture(scope="module")
def fleet(image: str) -> Iterator[Composition]:
    system = Composition("wyner-test-fleet", "fleet", {"WYNER_MESSAGE": "to all"})
    system.down()
    try:
        system.up("--scale", f"fleet-plant={LOOPS}", "--scale", f"fleet-controller={LOOPS}")
        yield system
    finally:
        system.down()
    assert leftovers(system.project) == []


def statuses(system: Composition, vantage: str) -> dict[str, dict[str, object]]:
    """The newest status of each loop, from one side."""
    program = "import json, pathlib\n" + (
        "print(json.dumps({p.parts[-3]: json.loads(p.read_bytes()) for p in "
        f"pathlib.Path('{RUN}').glob('loop-*/{vantage}/status.json')}}))"
    )
    found: dict[str, dict[str, object]] = json.loads(
        system.python(f"fleet-{vantage}", program).stdout
    )
    return found


def claims(system: Composition, service: str) -> list[str]:
    """Which loop each container of a service has claimed."""
    containers = system.compose("ps", "--quiet", service).stdout.split()
    return [docker("exec", c, "cat", "/tmp/claimed").strip() for c in containers]


@pytest.mark.parametrize("service", ["fleet-plant", "fleet-controller"])
def test_each_replica_has_a_loop_of_its_own(fleet: Composition, service: str) -> None:
    expected = sorted(f"{RUN}/loop-{n}" for n in range(1, LOOPS + 1))
    wait_for(lambda: sorted(claims(fleet, service)) == expected, 60, f"{LOOPS} loops claimed")


def test_every_message_arrives_on_its_own_loop(fleet: Composition) -> None:
    def all_there() -> bool:
        seen = statuses(fleet, "plant")
        return len(seen) == LOOPS and all(s["messages"] == 1 for s in seen.values())

    wait_for(all_there, 90, f"{LOOPS} messages")
    sessions = {name: s["session"] for name, s in statuses(fleet, "plant").items()}
    assert len(set(sessions.values())) == LOOPS
    assert {n: s["session"] for n, s in statuses(fleet, "controller").items()} == sessions


def test_a_message_reaches_the_loop_it_names_and_no_other(fleet: Composition) -> None:
    fleet.compose("run", "--rm", "--no-deps", "fleet-operator", "send", "to 3", "--loop", "loop-3")
    wait_for(
        lambda: statuses(fleet, "plant")["loop-3"]["messages"] == 2,
        60,
        "message on loop-3",
    )
    others = {n: s for n, s in statuses(fleet, "plant").items() if n != "loop-3"}
    assert {s["messages"] for s in others.values()} == {1}


def test_a_killed_plant_comes_back_to_the_loop_it_left(fleet: Composition) -> None:
    victim = fleet.container("fleet-plant")
    claimed = docker("exec", victim, "cat", "/tmp/claimed").strip()
    loop = claimed.rpartition("/")[2]
    before = statuses(fleet, "plant")[loop]
    fleet.kill("fleet-plant")

    def goes_on() -> bool:
        now = statuses(fleet, "plant")[loop]
        return now["session"] == before["session"] and int(str(now["transitions"])) > int(
            str(before["transitions"])
        )

    wait_for(goes_on, 30, f"{loop} going on")
    assert docker("exec", victim, "cat", "/tmp/claimed").strip() == claimed
