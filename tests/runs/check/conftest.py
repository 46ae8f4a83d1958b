"""A run of all three services that makes keys, and a copy of it to be spoilt."""

import shutil
from pathlib import Path

import pytest

from tests.support.checked_runs import keyed_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return keyed_run(tmp_path_factory)


@pytest.fixture
def copied(run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "run"))
