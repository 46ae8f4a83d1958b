"""The wheel: seven names, and what the command needs, away from the source tree."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
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


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT, folder / "source", ignore=not_source)
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--disable-pip-version-check",
            "--no-deps",
            "--no-build-isolation",
            "--wheel-dir",
            str(folder),
            "./source",
        ],
        cwd=folder,
        check=True,
        timeout=PATIENCE_S,
    )
    shutil.rmtree(folder / "source")
    (found,) = folder.glob("*.whl")
    return found


class Installed:
    """An environment that has the wheel, and its dependencies from the one that tests run in."""

    def __init__(self, wheel: Path, folder: Path) -> None:
        self.folder = folder
        subprocess.run(
            [sys.executable, "-m", "venv", "--without-pip", str(folder / "env")],
            check=True,
            timeout=PATIENCE_S,
        )
        self.python = folder / "env" / "bin" / "python"
        subprocess.run(
            [
                sys.executable,
                "-m",
                "pip",
                "--python",
                str(self.python),
                "install",
                "--quiet",
                "--disable-pip-version-check",
                "--no-deps",
                "--no-index",
                str(wheel),
            ],
            check=True,
            timeout=PATIENCE_S,
        )
        (packages,) = (folder / "env" / "lib").glob("python*/site-packages")
        # A path in a .pth file comes last, and .pth files there are not followed: the source tree
        # of an editable installation stays out of sight.
        (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
        self.packages = packages

    def run(self, *arguments: str, code: int = 0) -> str:
        return self._told("wyner", arguments, code)

    def _told(self, program: str, arguments: tuple[str, ...], code: int) -> str:
        hidden = {"PYTHONPATH", "XDG_CACHE_HOME"}
        done = subprocess.run(
            [str(self.folder / "env" / "bin" / program), *arguments],
            capture_output=True,
            text=True,
            cwd=self.folder,
            env={k: v for k, v in os.environ.items() if k not in hidden}
            | {"XDG_CACHE_HOME": str(self.folder / "cache")},
            timeout=PATIENCE_S,
            check=False,
        )
        assert done.returncode == code, done.stderr
        return done.stdout if code == 0 else done.stderr


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return Installed(wheel, tmp_path_factory.mktemp("away"))


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


def test_a_run(installed: Installed) -> None:
    out = installed.run(
        *("up", "--scenario", "sustained", "--pace", "fast", "--until-delivered"),
        *("--message", "Hi"),
    )
    assert "bits by the paper's rule. True: at most" in out
    (run,) = (installed.folder / "runs").iterdir()
    out = installed.run("check", str(run))
    assert " 0 FAIL" in out


def test_a_figure(installed: Installed) -> None:
    installed.run("design", "packed", "--plot", "mine.svg")
    assert (installed.folder / "mine.svg").stat().st_size > 10_000
