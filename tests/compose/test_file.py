"""The compose file itself, as both generations of Compose read it."""

import shutil
import subprocess

import pytest

from tests.compose.composition import ROOT, Composition


def test_compose_v2_reads_the_file_and_starts_the_direct_system_by_default(engine: str) -> None:
    shown = subprocess.run(
        ["docker", "compose", "-f", "compose.yaml", "config", "--services"],
        cwd=ROOT, capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert sorted(shown.stdout.split()) == ["controller", "knowledge", "plant", "tap"]


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="no docker-compose here")
def test_the_older_docker_compose_brings_the_system_up(image: str) -> None:
    system = Composition("wyner-test-older")
    older = ["docker-compose", "-f", "compose.yaml", "-p", system.project]

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*older, *arguments], cwd=ROOT, env=system.environment,
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip

    try:
        started = run("up", "--detach", "--no-build")
        assert started.returncode == 0, started.stderr
        services = run("ps", "--services", "--filter", "status=running").stdout.split()
        assert {"controller", "plant", "tap"} <= set(services)
    finally:
        ended = run("down", "--volumes")
    assert ended.returncode == 0, ended.stderr
