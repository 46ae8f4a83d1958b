"""The wheel: seven names, and what the command needs, away from the source tree."""

import os
import shutil
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.support.programs import ROOT, python

pytestmark = pytest.mark.long

BUILT = shutil.ignore_patterns("build", "*.egg-info", "__pycache__", ".*", "tests")
NAMES = {
    "protocol",
    "runtime",
    "controller_service",
    "plant_service",
    "tap_service",
    "attacker_service",
    "wyner",
}


def not_source(folder: str, names: list[str]) -> set[str]:
    """What is built, and the runs that somebody made in the checkout; `wyner/runs` is source."""
    return BUILT(folder, names) | ({"runs"} if Path(folder) == ROOT else set())


def pip(*arguments: str, cwd: Path) -> None:
    quiet = ("--quiet", "--disable-pip-version-check")
    done = python("-m", "pip", *quiet, *arguments, cwd=cwd)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT, folder / "source", ignore=not_source)
    pip("wheel", "--no-deps", "--no-build-isolation", "./source", cwd=folder)
    shutil.rmtree(folder / "source")
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def away(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder away from the source tree, in which the wheel is installed."""
    folder = tmp_path_factory.mktemp("away")
    pip("install", "--no-deps", "--no-index", "--target", "installed", str(wheel), cwd=folder)
    return folder


def wyner(away: Path, *arguments: str) -> str:
    """What the installed command says, with the tests' libraries and without the source tree."""
    installed = away / "installed"
    # Without `site` no .pth file is followed, and so none that leads to the source tree.
    path = os.pathsep.join([str(installed), sysconfig.get_path("purelib")])
    env = os.environ | {"PYTHONPATH": path, "XDG_CACHE_HOME": str(away / "cache")}
    done = python("-S", installed / "bin" / "wyner", *arguments, cwd=away, env=env)
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


def test_what_is_installed_and_no_more(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        files = archive.namelist()
    top = {name.split("/")[0] for name in files}
    assert {name for name in top if not name.endswith(".dist-info")} == NAMES
    for folder in ("runtime/scenarios", "wyner/sweeps"):
        shipped = {f"{folder}/{p.name}" for p in (ROOT / folder).glob("*.toml")}
        assert shipped
        assert shipped <= set(files)
    assert not [name for name in files if name.endswith(".csv")]


def test_a_run_and_a_figure(away: Path) -> None:
    options = ["--scenario", "sustained", "--pace", "fast", "--until-delivered"]
    out = wyner(away, "up", *options, "--message", "Hi")
    assert "bits by the paper's rule. True: at most" in out
    (run,) = (away / "runs").iterdir()
    assert " 0 FAIL" in wyner(away, "check", str(run))
    wyner(away, "design", "packed", "--plot", "mine.svg")
    assert (away / "mine.svg").stat().st_size > 10_000
