"""Scenarios of one's own: listed, written, read back; a sweep with a tap, and its figure."""

import csv
import json
import re
from contextlib import chdir
from pathlib import Path

import pytest

from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from tests.support.size import size
from wyner.cli.main import main
from wyner.cli.new import sampled
from wyner.fit.first_scenario import first_scenario


def new(path: Path, *arguments: str) -> int:
    """`wyner new` in a folder."""
    with chdir(path.parent):
        return main(["new", path.stem, *arguments])


def first(
    path: Path, A: list[list[float]], B: list[list[float]], period_s: float, width: float
) -> bool:
    """A new scenario of a continuous plant, its D of this half-width in each state."""
    matrices = sampled(A, B, period_s)
    text, starts = first_scenario(path.stem, *matrices, period_s, [1.0], [width] * len(A))
    path.write_text(text)
    return starts


def test_the_shipped_scenarios_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert set(listed) == {load_scenario(path).name for path in SCENARIOS.glob("*.toml")}
    assert main(["design"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines()[:-1])) < 80
    told = " ".join(out.split())
    assert all(f"{name}: " in told and one["description"] in told for name, one in listed.items())


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
    assert made["why"]["agreed"]["low"] > 0.2
    text = Path("mass.toml").read_text()
    fields = [line for line in text.splitlines() if "=" in line and not line.startswith("#")]
    assert sum("#" in line for line in text.splitlines()) > len(fields) // 2
    assert main(["new", "mass"]) == 2
    assert "is there already" in capsys.readouterr().err


UNITS = size([(1e-4, 1e4), (1.0, 1e-4)], [(1e-4, 1e4), (1e4, 1.0), (100.0, 100.0), (1.0, 1e-4)])


@pytest.mark.long
@pytest.mark.parametrize("units", UNITS)
def test_the_same_plant_in_other_units_gets_the_same_design(
    units: tuple[float, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pendulum; its states are counted in units of other sizes."""
    designs = []
    for k, (p, q) in enumerate([(1.0, 1.0), units]):
        path = tmp_path / f"p{k}.toml"
        A, B = [[0, p / q], [9.81 * q / p, -0.1]], [[0], [q]]
        written = ["--A", json.dumps(A), "--B", json.dumps(B), "--period", "0.05", "--continuous"]
        assert new(path, *written) == 0
        capsys.readouterr()
        assert main(["design", str(path), "--json"]) == 0
        made = json.loads(capsys.readouterr().out)
        gain = [v * unit for v, unit in zip(made["gain"][0], (p, q), strict=True)]
        areas = [s["area"] / (p * q) for s in made["sets"]]
        designs.append((*gain, *areas, made["rate"]["bits_per_second"]))
    assert designs[0] == pytest.approx(designs[1], rel=1e-6)
    assert designs[0][-1] > 1


MOTOR = [[0.0, 1.0, 0.0], [0.0, -10.0, 1.0], [0.0, -0.02, -2.0]], [[0.0], [0.0], [2.0]]
"""A textbook's motor: position, speed and current."""


def with_weights(text: str, next_state: str) -> str:
    """The file with a regulator's weights in place of its gain, and few sets."""
    table = r"^\[control\.regulator\].*\nnext_state = .*\ninput = .*$"
    found = re.search(rf"^gain = .*$|{table}", text, re.MULTILINE)
    assert found is not None
    weights = f"[control.regulator]\nnext_state = {next_state}\ninput = [1.0]\n"
    text = text.replace(found[0], weights)
    return re.sub(r"horizon = \d+", "horizon = 3", text)


def advised(told: str, text: str) -> str:
    """The file with what a refusal advises in place of its regulator."""
    found = re.search(r"(control\.)(gain = \S.*\]\]) in place of \[control\.regulator\]", told)
    assert found is not None, told
    text = re.sub(r"\[control\.regulator\][^\n]*\n(.*=.*\n)+", found[2] + "\n", text)
    share = re.search(r"\(and plant\.disturbance\) ([\d.]+) of today's", told)
    if share is None:
        return text

    def less(row: re.Match[str]) -> str:
        widths = [float(share[1]) * v for v in json.loads(row[2])]
        return f"{row[1]}{widths}"

    return re.sub(r"(disturbance\].*\n(?:kind.*\n)?half_widths = )(\[.*\])", less, text)


@pytest.mark.long
def test_a_regulator_that_is_too_slow_names_the_state_and_the_remedies_help(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "motor.toml"
    first(path, *MOTOR, 0.001, 1e-7)
    made = path.read_text()
    text = with_weights(made, "[1.0, 1.0, 1.0]")
    path.write_text(text)
    capsys.readouterr()
    assert main(["design", str(path)]) == 2
    told = capsys.readouterr().err
    assert "K is too slow; x_1 comes back slowest: a larger regulator.next_state of x_1" in told
    for mended in (with_weights(made, "[100.0, 1.0, 1.0]"), advised(told, text)):
        path.write_text(mended)
        assert main(["design", str(path)]) == 0


TWO_MASSES = (
    [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-2, 1, -0.02, 0.01], [1, -2, 0.01, -0.02]],
    [[0.0], [0.0], [1.0], [0.0]],
)
"""Two masses between three springs, damped by one per cent, the first one pushed."""


@pytest.mark.parametrize(("disturbance", "needs_less"), [(1e-6, False), (0.01, True)])
def test_a_refusal_names_a_gain_that_does(
    disturbance: float, needs_less: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "masses.toml"
    assert first(path, *TWO_MASSES, 0.05, disturbance) != needs_less
    text = path.read_text()
    if not needs_less:
        text = with_weights(text, "[1.0, 1.0, 1.0, 1.0]")
    path.write_text(re.sub(r"horizon = \d+", "horizon = 3", text))
    assert main(["design", str(path)]) == 2
    told = capsys.readouterr().err
    assert "turns faster than it decays (abs(re) + abs(im) is 1.0" in told
    assert told.count("\n") == 1
    assert ("of today's" in told) == needs_less
    path.write_text(advised(told, path.read_text()))
    assert main(["design", str(path)]) == 0


def test_a_mode_that_no_input_moves_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "apart.toml"
    matrices = ["--A", "[2 0; 0 0.5]", "--B", "[0; 1]", "--period", "1"]
    assert new(path, *matrices) == 0
    assert main(["design", str(path)]) == 2
    told = "plant.B: no input moves the mode of A with eigenvalue 2, seen most in x_1"
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        "[[0, 1], [-2, -0.5]]",
        "[0 1; -2 -0.5]",
        "[0, 1; -2, -0.5]",
        "0 1; -2 -.5;",
        "[0 1\n -2 -5e-1]",
        "[[ 0.   1. ]\n [-2.  -0.5]]",
        "[[0 1], [-2 -0.5]]",
    ],
)
def test_a_matrix_may_be_written_as_matlab_or_numpy_write_it(text: str, tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    matrices = ["--A", text, "--B", "[0; 1]", "--period", "0.5"]
    assert new(path, *matrices) == 0
    scenario = load_scenario(path)
    assert scenario.A == ((0.0, 1.0), (-2.0, -0.5))
    assert scenario.B == ((0.0,), (1.0,))


ONE = ("--B", "[[1]]", "--period", "1")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--A", "[[1]]"], "expected --A, --B and --period together"),
        (["--A", "[[1], [1, 2]]", *ONE], "--A: got '[[1], [1, 2]]'"),
        (["--A", "[1 2; 3]", *ONE], "--A: got '[1 2; 3]'"),
        (["--A", "[1 - 2]", *ONE], "--A: row 1: '-' is no number"),
        (["--A", "[[1, 2], [3, 4]", *ONE], "or [1 0.1; 0 1]"),
        (["--A", "[1e999]", *ONE], "--A: got '[1e999]'"),
        (["--A", "[[1" + "0" * 400 + "]]", *ONE], "--A: got '[[1"),
        (["--A", "[" * 9999, *ONE], "--A: got '[[["),
        (["--A", "[[NaN]]", *ONE], "--A: row 1: 'NaN' is no number"),
        (["--A", "1e9", *ONE, "--continuous"], "--A, --B: sampled over 1 s"),
        (["--A", "1 0 0 0 0;" * 5, "--B", "1; 1; 1; 1; 1", "--period", "1"], "got 5 states, 1 inp"),
        (["--A", "[[1]]", "--B", "[[1], [2]]", "--period", "1"], "got 1 x 1 and 2 x 1"),
        (["--A", "[[1]]", "--B", "[[1]]", "--period", "0"], "--period: got 0"),
        (["--A", "[[1]]", "--B", "[[1]]", "--period", "inf"], "--period: got inf"),
        (["--input", "nan"], "--input: got nan"),
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
    assert main(["new", "x", *arguments]) == 2
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
        'name = "s"\nscenario = "sustained"\nruns = 6\nsteps = 300\nseed = 7\nmessage = "a"\n'
        'eavesdroppers = ["mine.py:Mine", "oracle"]\n[grid]\n"secrecy.alpha" = [3.0, 8.0]\n'
    )
    rows = tmp_path / "s.csv"
    assert main(["sweep", str(sweep), "--output", str(rows), "--jobs", "1"]) == 0
    out = capsys.readouterr().out
    assert "  mine  " in out
    with rows.open() as file:
        added = list(csv.DictReader(file))
    assert all(int(r["tap.mine.right"]) == int(r["tap.mine.agreed"]) > 50 for r in added)
    assert all(int(r["tap.oracle.read"]) == int(r["tap.oracle.delivered"]) > 0 for r in added)
    with (tmp_path / "s-rates.csv").open() as file:
        ready = list(csv.DictReader(file))
    assert [r["secrecy.alpha"] for r in ready] == ["3.0", "8.0"]
    for r in ready:
        assert float(r["bits_per_second_low"]) <= float(r["bits_per_second"])
        assert r["mine keys known"] == "1.0"
        assert 0.5 < float(r["mine keys known low"]) < 1  # six runs, each all right
    assert main(["sweep", str(sweep), "--output", str(rows), "--resume", "--jobs", "1"]) == 0
    assert "0 of them new" in capsys.readouterr().out
    for arguments in (
        [str(rows), "--plot"],
        [str(tmp_path / "s-rates.csv"), "--plot", str(tmp_path / "rates.pdf")],
        [str(rows), "--plot", "--y", "mine keys known", "--y", "oracle messages read"],
    ):
        assert main(["sweep", *arguments]) == 0
        drawn = Path(capsys.readouterr().out.strip())
        assert drawn.stat().st_size > 5_000
    for arguments, told in (
        ([str(rows), "--plot", "--y", "nothing"], "--y: got 'nothing', expected one of: scenario"),
        ([str(rows)], "FILE: got rows"),
        ([str(rows), "--plot", "a.gif"], "ends in .png, .pdf, .svg"),
        ([str(sweep), "--output", str(tmp_path / "t.csv"), "--plot", "a.gif"], "ends in .png"),
    ):
        assert main(["sweep", *arguments]) == 2
        assert told in capsys.readouterr().err
    assert not (tmp_path / "t.csv").exists(), "told before the sweep is run, not after"
