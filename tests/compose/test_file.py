"""The compose file itself, as both generations of Compose read it."""

import subprocess
from collections.abc import Iterator

import pytest

from tests.compose.composition import PATIENCE_S, ROOT, Composition, leftovers


def test_compose_v2_reads_the_file_and_starts_the_direct_system_by_default(engine: str) -> None:
    shown = subprocess.run(
        ["docker", "compose", "-f", "compose.yaml", "config", "--services"],
        cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=True,
    )  # fmt: skip
    assert sorted(shown.stdout.split()) == ["controller", "knowledge", "plant", "settings", "tap"]


@pytest.fixture(scope="module")
def project(image: str) -> Iterator[str]:
    """The name of one project for all mistakes: each `up` makes anew what the mistake changes."""
    name = "wyner-test-settings"
    Composition(name).down()
    yield name
    Composition(name).down()
    assert leftovers(name) == []


@pytest.mark.parametrize(
    ("profile", "variable", "value", "expected"),
    [
        ("direct", "WYNER_SCENARIO", "nosuch", "/scenarios/nosuch.toml: no such file; "),
        ("secure", "WYNER_PACE", "x0", "--pace: got 'x0'"),
        ("fleet", "WYNER_LOOPS", "0", "--fleet: got 0"),
    ],
)
def test_with_a_wrong_variable_nothing_starts_and_it_is_named(
    project: str, profile: str, variable: str, value: str, expected: str
) -> None:
    system = Composition(project, profile, {variable: value})
    started = system.compose("up", "--detach", "--no-build", check=False)
    assert started.returncode != 0
    assert "settings" in started.stderr
    assert f"{variable}: {expected}" in system.compose("logs", "settings").stdout
    running = system.compose("ps", "--services", "--status", "running").stdout.split()
    assert set(running) <= {"fleet-router"}
