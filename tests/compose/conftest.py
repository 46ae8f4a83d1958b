"""The system in containers, for real: these tests need a Docker engine, and run when asked for.

``make test-compose``, or ``pytest tests/compose``. A plain ``pytest`` leaves this folder out.
"""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.compose.composition import (
    BASE_IMAGE,
    PACE,
    Composition,
    base_image,
    docker,
    leftovers,
)

NO_ENGINE = (
    "No Docker engine answers, and these tests start containers. To get one: on Debian, as root, "
    "`deploy/engine install && deploy/engine start` installs and starts Debian's own; elsewhere "
    "https://docs.docker.com/engine/install/ says how. Where no image registry is reached, "
    "`deploy/base-image` makes a base image."
)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave this folder out unless it is named on the command line."""
    return None if any("compose" in argument for argument in config.args) else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Half an hour a test: the first one builds the image, and the machine may be slow."""
    for item in items:
        if item.path.parent == Path(__file__).parent:
            item.add_marker(pytest.mark.timeout(1800))


@pytest.fixture(scope="session")
def engine() -> str:
    """The engine's version; without an engine the run ends here."""
    try:
        return docker("version", "--format", "{{.Server.Version}}").strip()
    except (OSError, subprocess.CalledProcessError):
        pytest.exit(NO_ENGINE, returncode=1)


@pytest.fixture(scope="session")
def image(engine: str) -> str:
    """The image that all services run, built from this tree."""
    builder = Composition("wyner-test-build")
    built = builder.compose("build", "controller", check=False, timeout=1800)
    assert built.returncode == 0, (
        f"building on {base_image()} failed (BASE_IMAGE chooses another base, "
        f"deploy/base-image makes {BASE_IMAGE}):\n{built.stderr[-3000:]}"
    )
    return builder.image


def running(project: str, profile: str, **variables: str) -> Iterator[Composition]:
    """A system that is up for some tests, and gone afterwards without a trace."""
    system = Composition(project, profile, variables)
    system.down()
    try:
        system.up()
        yield system
    finally:
        system.down()
    assert leftovers(project) == []


@pytest.fixture(scope="session")
def direct(image: str) -> Iterator[Composition]:
    """One system for the tests of two files; the last of them stops it."""
    variables = {"WYNER_MESSAGE": "at noon", "WYNER_PACE": PACE}
    yield from running("wyner-test-direct", "direct", **variables)


@pytest.fixture(scope="module")
def secure(image: str) -> Iterator[Composition]:
    variables = {"WYNER_MESSAGE": "at noon", "WYNER_PACE": PACE}
    yield from running("wyner-test-secure", "secure", **variables)
