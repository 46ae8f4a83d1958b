"""The compose file itself, as both generations of Compose read it."""

import shutil
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


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="no docker-compose here")
def test_the_older_docker_compose_brings_the_system_up(image: str) -> None:
    system = Composition("wyner-test-older")
    older = ["docker-compose", "-f", "compose.yaml", "-p", system.project]

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*older, *arguments], cwd=ROOT, env=system.environment,
            capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip

    try:
        started = run("up", "--detach", "--no-build")
        assert started.returncode == 0, started.stderr
        services = run("ps", "--services", "--filter", "status=running").stdout.split()
        assert {"controller", "plant", "tap"} <= set(services)
    finally:
        ended = run("down", "--volumes")
    assert ended.returncode == 0, ended.stderr


WRONG = {
    "WYNER_PACE": ("x0", "--pace: got 'x0'"),
    "WYNER_SCENARIO": (
        "nosuch",
        "/scenarios/nosuch.toml: no such file; /scenarios has batch-reactor, ",
    ),
    "WYNER_TAPS": ("nobody", "--eavesdropper: got 'nobody'"),
    "WYNER_MESSAGE": ("x" * 70_000, "message: got 70000 bytes"),
    "WYNER_LOOPS": ("0", "--fleet: got 0"),
}


@pytest.fixture(scope="module")
def project(image: str) -> Iterator[str]:
    """The name of one project for all mistakes: each `up` makes anew what the mistake changes."""
    name = "wyner-test-settings"
    Composition(name).down()
    yield name
    Composition(name).down()
    assert leftovers(name) == []


@pytest.mark.parametrize(
    ("profile", "variable"),
    [
        *(("direct", name) for name in WRONG),
        ("secure", "WYNER_PACE"),
        ("fleet", "WYNER_LOOPS"),
    ],
)
def test_with_a_wrong_variable_nothing_starts_and_it_is_named(
    project: str, profile: str, variable: str
) -> None:
    value, expected = WRONG[variable]
    system = Composition(project, profile, {variable: value})
    started = system.compose("up", "--detach", "--no-build", check=False)
    assert started.returncode != 0
    assert "settings" in started.stderr
    assert f"{variable}: {expected}" in system.compose("logs", "settings").stdout
    running = system.compose("ps", "--services", "--status", "running").stdout.split()
    assert set(running) <= {"fleet-router"}
