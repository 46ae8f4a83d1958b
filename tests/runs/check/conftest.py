"""A run of all three services that makes keys, a run of the ends alone, and copies to be spoilt."""

import shutil
from pathlib import Path

import pytest

from tests.support.checked_runs import keyed_run
from tests.support.ended_run import ended_run
from tests.support.lines import unmarked


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return keyed_run(tmp_path_factory)


@pytest.fixture
def copied(run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "run"))


@pytest.fixture(scope="package")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with all that a run leaves: two messages, losses, repeats, deaths, a lost journal."""
    return ended_run(tmp_path_factory.mktemp("runs") / "ended", (b"",)).folder


@pytest.fixture(scope="package")
def killed(ended: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, without the end marks that count its lines."""
    return unmarked(Path(shutil.copytree(ended, tmp_path_factory.mktemp("runs") / "killed")))
