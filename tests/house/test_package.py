"""The wheel: what is installed away from the source tree brings what the command needs."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUILT = ("build", "*.egg-info", "__pycache__", ".*", "runs", "docs", "tests")


@pytest.mark.slow
def test_a_wheel_finds_its_own_scenarios_and_sweeps(tmp_path: Path) -> None:
    shutil.copytree(ROOT, tmp_path / "source", ignore=shutil.ignore_patterns(*BUILT))
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run(
        [*pip, "install", "--no-deps", "--no-build-isolation", "--target", "installed", "./source"],
        cwd=tmp_path,
        check=True,
        timeout=120,
    )
    shutil.rmtree(tmp_path / "source")
    # without the finder of an editable installation, which would find the source tree
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path / 'installed')!r})\n"
        "sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in repr(f).lower()]\n"
        "from wyner.studies.grid import load_sweep\n"
        "from protocol.shipped import SCENARIOS\n"
        "from wyner.shipped import SWEEPS\n"
        "from protocol.scenario.files import scenario_of\n"
        "print(*(scenario_of(f.stem).name for f in SCENARIOS.glob('*.toml')))\n"
        "print(*(load_sweep(f).name for f in SWEEPS.glob('*.toml')))\n"
        "print(SCENARIOS)\n"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    scenarios, sweeps, where = done.stdout.splitlines()
    assert where == str(tmp_path / "installed" / "wyner" / "scenarios")
    assert set(scenarios.split()) == {f.stem for f in (ROOT / "wyner" / "scenarios").glob("*.toml")}
    assert len(sweeps.split()) == len(list((ROOT / "wyner" / "sweeps").glob("*.toml"))) > 0
