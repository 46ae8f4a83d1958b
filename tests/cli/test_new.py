"""Scenarios of one's own: listed, written, read back; a sweep with a tap, and its figure."""

import csv
import json
from pathlib import Path

import pytest

from protocol.scenario import load_scenario
from protocol.shipped import SCENARIOS
from wyner.cli.main import main


def test_the_shipped_scenarios_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenarios", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert set(listed) == {load_scenario(path).name for path in SCENARIOS.glob("*.toml")}
    assert main(["scenarios"]) == 0
    out = capsys.readouterr().out
    assert all(name in out and about["description"] in out for name, about in listed.items())


def test_a_new_scenario_is_read_back_and_has_a_design(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mass"]) == 0
    scenario = load_scenario("mass.toml")
    assert scenario.A == ((1.0, 0.1), (0.0, 1.0))
    assert [row[0] for row in scenario.B] == pytest.approx([0.005, 0.1])
    capsys.readouterr()
    assert main(["design", "mass.toml", "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["rate"]["bits_per_second"] > 1
    assert made["why"]["agreed"] > 0.2
    text = Path("mass.toml").read_text()
    fields = [line for line in text.splitlines() if "=" in line and not line.startswith("#")]
    assert sum("#" in line for line in text.splitlines()) > len(fields) // 2
    assert main(["new", "mass"]) == 2
    assert "is there already" in capsys.readouterr().err


def test_discrete_matrices_stand_as_they_are_given(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    matrices = ["--A", "[[0.9, 0.1], [0, 0.8]]", "--B", "[[0, 1], [1, 0]]", "--period", "0.5"]
    assert main(["new", "own", *matrices, "--input", "2", "--output", str(path)]) == 0
    scenario = load_scenario(path)
    assert scenario.A == ((0.9, 0.1), (0.0, 0.8))
    assert (scenario.n, scenario.m, scenario.plant.period_s) == (2, 2, 0.5)
    assert scenario.control.inputs.half_widths == (2.0, 2.0)


MOTOR = ["--A", "[[0, 1, 0], [0, -10, 1], [0, -0.02, -2]]", "--B", "[[0], [0], [2]]"]
"""A textbook's motor: position, speed and current."""


def test_a_motor_of_three_states_has_a_design_as_it_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its regulator is slow: T_0 has room for rounding around a D_c that is a little larger."""
    path = tmp_path / "motor.toml"
    written = ["new", "motor", *MOTOR, "--continuous", "--period", "0.05", "--output", str(path)]
    assert main(written) == 0
    assert "3 states, 1 input; `wyner design" in capsys.readouterr().out
    path.write_text(path.read_text().replace("horizon = 30", "horizon = 5"))
    assert main(["design", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rate"]["bits_per_second"] > 4


def test_a_regulator_that_is_too_slow_names_the_state_and_the_remedy_helps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "motor.toml"
    fast = ["new", "motor", *MOTOR, "--continuous", "--period", "0.001", "--disturbance", "1e-7"]
    assert main([*fast, "--output", str(path)]) == 0
    text = path.read_text().replace("horizon = 30", "horizon = 5")
    stated = "next_state = [1.0, 1.0, 1.0]"
    assert text.count(stated) == 1
    path.write_text(text)
    capsys.readouterr()
    assert main(["design", str(path)]) == 2
    told = capsys.readouterr().err
    assert "K is too slow; x_1 comes back slowest: a larger regulator.next_state of x_1" in told
    path.write_text(text.replace(stated, "next_state = [100.0, 1.0, 1.0]"))
    assert main(["design", str(path)]) == 0


def test_a_plant_without_a_terminal_set_is_written_and_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wild.toml"
    matrices = ["--A", "[[3, 0], [0, 3]]", "--B", "[[1], [1]]", "--period", "1"]
    assert main(["new", "wild", *matrices, "--output", str(path)]) == 0
    assert "says why it has no terminal set yet" in capsys.readouterr().out
    assert main(["design", str(path)]) == 2


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["x", "--A", "[[1]]"], "expected --A, --B and --period together"),
        (
            ["x", "--A", "[[1], [1, 2]]", "--B", "[[1]]", "--period", "1"],
            "--A: got '[[1], [1, 2]]'",
        ),
        (["x", "--A", "one", "--B", "[[1]]", "--period", "1"], "--A: got 'one'"),
        (["x", "--A", "[[1]]", "--B", "[[1], [2]]", "--period", "1"], "got 1 x 1 and 2 x 1"),
        (["x", "--A", "[[1]]", "--B", "[[1]]", "--period", "0"], "--period: got 0"),
        (["a b"], "name: got"),
    ],
)
def test_what_is_wrong_is_told_in_a_line(
    arguments: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", *arguments]) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


MINE = """
from tap_service.eavesdroppers.nearest_centre import NearestCentre

class Mine(NearestCentre):
    name = "mine"
"""


@pytest.mark.slow
def test_from_a_sweep_with_a_tap_of_ones_own_to_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    sweep = tmp_path / "s.toml"
    sweep.write_text(
        'name = "s"\nscenario = "sustained"\nruns = 3\nsteps = 300\nseed = 7\nmessage = "a"\n'
        'eavesdroppers = ["mine.py:Mine", "oracle"]\n[grid]\n"secrecy.alpha" = [3.0, 8.0]\n'
    )
    rows = tmp_path / "s.csv"
    assert main(["sweep", str(sweep), "--output", str(rows), "--jobs", "1"]) == 0
    out = capsys.readouterr().out
    assert "Mine keys, messages" in out
    with rows.open() as file:
        added = list(csv.DictReader(file))
    assert all(int(r["tap.Mine.right"]) == int(r["tap.Mine.agreed"]) > 50 for r in added)
    assert all(int(r["tap.oracle.read"]) == int(r["tap.oracle.delivered"]) > 0 for r in added)
    with (tmp_path / "s-rates.csv").open() as file:
        ready = list(csv.DictReader(file))
    assert [r["secrecy.alpha"] for r in ready] == ["3.0", "8.0"]
    for r in ready:
        assert float(r["bits_per_second_low"]) <= float(r["bits_per_second"])
        assert r["Mine keys right"] == "1.0"
        assert 0.9 < float(r["Mine keys right low"]) < 1
    assert main(["sweep", str(sweep), "--output", str(rows), "--resume", "--jobs", "1"]) == 0
    assert "0 of them new" in capsys.readouterr().out
    for arguments in (
        [str(rows)],
        [str(tmp_path / "s-rates.csv"), "--output", str(tmp_path / "rates.pdf"), "--log"],
        [str(rows), "--y", "Mine keys right", "--y", "oracle messages read"],
    ):
        assert main(["plot", *arguments]) == 0
        drawn = Path(capsys.readouterr().out.strip())
        assert drawn.stat().st_size > 5_000
    for arguments, told in (
        ([str(rows), "--y", "nothing"], "--y: got 'nothing', expected one of: scenario"),
        ([str(rows), "--x", "scenario"], "--x: scenario: got 'sustained', expected numbers"),
        ([str(sweep)], "s.toml"),
        ([str(rows), "--output", "a.gif"], "ends in .png, .pdf, .svg"),
    ):
        assert main(["plot", *arguments]) == 2
        assert told in capsys.readouterr().err


def test_a_sweep_names_an_eavesdropper_that_is_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = tmp_path / "s.toml"
    sweep.write_text(
        'name = "s"\nscenario = "sustained"\nruns = 1\nsteps = 10\nseed = 7\n'
        'eavesdroppers = ["nobody"]\n'
    )
    assert main(["sweep", str(sweep), "--output", str(tmp_path / "s.csv")]) == 2
    assert "eavesdropper: got 'nobody'" in capsys.readouterr().err
