"""``wyner status``: what was last said, and each thing that contradicts it."""

import json
import time
from pathlib import Path

import pytest

from runtime.run_folder import BELIEFS, CONTROLLER_STATUS, PLANT_STATUS, SCENARIO
from tests.support.scenarios import text_of
from wyner.cli.main import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("status") / "run"
    options = ("--scenario", "packed", "--pace", "fast", "--steps", "60")
    assert main(["up", *options, "--run-dir", str(folder)]) == 0
    return folder


def changed(run_dir: Path, tmp_path: Path, file: Path, **fields: object) -> Path:
    """A copy of both statuses, one with other fields; a dict has those of a part."""
    for path in (PLANT_STATUS, CONTROLLER_STATUS):
        told = json.loads((run_dir / path).read_bytes())
        for name, value in fields.items() if path == file else ():
            told[name] = told[name] | value if isinstance(value, dict) else value
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(json.dumps(told))
    return tmp_path


def test_a_run_without_trouble(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(run_dir)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("plant       stopped, step 60, ")
    assert "warning" not in out
    assert main(["status", str(run_dir), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["plant"]["step"]["k"] == 60
    assert told["warnings"] == []


@pytest.mark.parametrize(
    ("file", "fields", "warning"),
    [
        (PLANT_STATUS, {"step": {"outside": 3}}, "d was outside D_c in 3 steps"),
        (
            PLANT_STATUS,
            {"step": {"symbol_errors": 1}},
            "1 agreed keys are not the input that was applied",
        ),
        (
            PLANT_STATUS,
            {"detail": "D_c is left more often than its calibration promised"},
            "D_c is left more often than its calibration promised",
        ),
        (PLANT_STATUS, {"keys": {"refused": "eps_E = 0"}}, "keys: eps_E = 0"),
        (PLANT_STATUS, {"keys": {"stopped": "refuted"}}, "keys stopped: refuted"),
        (
            CONTROLLER_STATUS,
            {"keys": {"stopped": "refuted"}},
            "keys stopped at the controller: refuted",
        ),
        (
            CONTROLLER_STATUS,
            {"step": {"unexplained": 2}},
            "2 transitions that no candidate explains",
        ),
        (
            PLANT_STATUS,
            {"phase": "running", "t_ns": 1},
            "plant last reported ",
        ),
    ],
)
def test_each_contradiction_is_a_line_and_an_exit_code(
    run_dir: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    file: Path,
    fields: dict[str, object],
    warning: str,
) -> None:
    assert main(["status", str(changed(run_dir, tmp_path, file, **fields))]) == 1
    assert f"warning: {warning}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("found", "warning"),
    [
        ({"bits": 512}, "the tap holds 512 bits of keys"),
        (
            {"refuted": True},
            "the tap misses 0.12 of the offers at most: the operator's claim is refuted",
        ),
        ({"bursts": True}, "the tap's misses come in bursts"),
    ],
)
def test_what_the_tap_found_against_the_claim_is_a_warning(
    run_dir: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    found: dict[str, object],
    warning: str,
) -> None:
    folder = changed(run_dir, tmp_path, PLANT_STATUS)
    keys = {"bits": 0, "at_most": 0.123, "refuted": False, "bursts": False, "direction": "offers"}
    keys |= found
    (folder / BELIEFS).parent.mkdir()
    (folder / BELIEFS).write_text(json.dumps({"a": {"keys": None}, "key-solver": {"keys": keys}}))
    assert main(["status", str(folder)]) == 1
    assert capsys.readouterr().out.count("warning: ") == 1
    assert main(["status", str(folder), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["warnings"] == [warning]


def test_of_a_fleet_the_loops_that_are_not_well_are_named(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, health in (("a", "ok: 0 % missed lately"), ("b", "bad: no step for 10 s")):
        told = {"health": health, "phase": "running", "t_ns": time.time_ns()}
        (tmp_path / name).mkdir()
        changed(run_dir, tmp_path / name, PLANT_STATUS, **told)
        (tmp_path / name / SCENARIO).write_text(text_of("packed"))
    assert main(["status", str(tmp_path)]) == 1
    assert capsys.readouterr().out == (
        "1 of 2 loops without a warning\nwarning: b: plant: no step for 10 s\n"
    )
