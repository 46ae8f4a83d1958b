"""Everything ends when told to, soon, with exit code 0, and leaves nothing behind.

A service that needed more than the grace of the compose file would be killed, and end with 137.
"""

from collections.abc import Iterator

import pytest

from tests.compose.composition import (
    PACE,
    Composition,
    all_healthy,
    leftovers,
    wait_for,
)

SERVICES = ("controller", "plant", "tap")
GRACE_S = 5.0


@pytest.fixture(scope="module")
def system(image: str) -> Iterator[Composition]:
    """One run for all tests of this file; each leaves it stopped."""
    system = Composition("wyner-test-stop", "direct", {"WYNER_PACE": PACE})
    system.down()
    yield system
    system.down()
    assert leftovers(system.project) == []


def exit_codes(system: Composition) -> dict[str, int]:
    return {s: system.inspect(s)["State"]["ExitCode"] for s in SERVICES}


def soon(system: Composition, busy_s: float) -> None:
    """Each service ended within its grace; a machine that was busy by itself is allowed for."""
    took = {s: system.stopped_in_s(s) for s in SERVICES}
    assert max(took.values()) < max(GRACE_S, 10 * busy_s), (took, busy_s)


def test_stop_is_a_clean_end_and_a_restarted_system_goes_on(system: Composition) -> None:
    system.up()
    all_healthy(system, SERVICES)
    before = system.status("plant", "plant")
    busy_s = system.busy_s("plant")
    system.compose("stop")
    assert exit_codes(system) == dict.fromkeys(SERVICES, 0)
    soon(system, busy_s)
    system.up()
    # The same session, from the journals in the volumes: nothing began anew.
    after = wait_for(
        lambda: (s := system.status("plant", "plant"))["transitions"] > before["transitions"] and s,
        "transitions",
    )
    assert after["session"] == before["session"]
    assert after["sessions"] == 1
