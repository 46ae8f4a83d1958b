"""Everything ends when told to, with exit code 0, and leaves nothing behind.

A service that needed more than the grace of the compose file would be killed, and end with 137.
"""

from collections.abc import Iterator

import pytest

from tests.compose.composition import (
    PACE,
    PATIENCE_S,
    Composition,
    advancing,
    all_healthy,
    leftovers,
    wait_for,
)
from tests.compose.terminal import Terminal

SERVICES = ("controller", "plant", "tap")


@pytest.fixture
def system(image: str) -> Iterator[Composition]:
    system = Composition("wyner-test-stop", "direct", {"WYNER_PACE": PACE})
    system.down()
    yield system
    system.down()
    assert leftovers(system.project) == []


def exit_codes(system: Composition) -> dict[str, int]:
    return {s: system.inspect(s)["State"]["ExitCode"] for s in SERVICES}


def none_runs(system: Composition) -> bool:
    return not any(system.inspect(s)["State"]["Running"] for s in SERVICES)


def test_control_c_stops_everything(system: Composition) -> None:
    with Terminal(system.command("up", "--no-build"), system.environment) as terminal:
        wait_for(lambda: system.container("tap"), "containers")
        all_healthy(system, SERVICES)
        terminal.press("\x03")
        code = terminal.wait(PATIENCE_S)
    assert none_runs(system)
    assert exit_codes(system) == dict.fromkeys(SERVICES, 0)
    # 130 would say that Compose got a signal, and not the key that .env makes of it. Compose 2.26
    # may panic when all is stopped; what this project's services end with is above.
    assert code == 0 or "panic" in terminal.output


def test_stop_is_a_clean_end_for_every_service(system: Composition) -> None:
    system.up()
    all_healthy(system, SERVICES)
    system.compose("stop")
    assert exit_codes(system) == dict.fromkeys(SERVICES, 0)


def test_a_restarted_system_goes_on_where_it_was(system: Composition) -> None:
    system.up()
    advancing(system)
    before = system.status("plant", "plant")
    system.compose("stop")
    system.up()
    # The same session, from the journals in the volumes: nothing began anew.
    after = wait_for(
        lambda: (s := system.status("plant", "plant"))["transitions"] > before["transitions"] and s,
        "transitions",
    )
    assert after["session"] == before["session"]
    assert after["sessions"] == 1
