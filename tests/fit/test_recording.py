"""A scenario from a recording: what it finds, what it promises, and what it refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from protocol.arrays import Array
from runtime.scenario_file import load_scenario
from tests.support.bare_figures import bare_figures
from wyner.api import design, run
from wyner.cli.main import main
from wyner.fit.recording import read_recording

A = np.array([[1.0, 0.1], [0.0, 0.95]])
B = np.array([[0.005], [0.1]])
D = np.array([0.002, 0.01])
COLUMNS = ["--states", "position,speed", "--inputs", "force", "--period", "0.1"]


def recorded(seed: int, steps: int = 2000, excitation: float = 1.0) -> tuple[Array, Array]:
    """States and inputs of a cart that a regulator holds while a random force is added."""
    rng = np.random.default_rng(seed)
    x, xs, us = np.zeros(2), [], []
    for _ in range(steps):
        u = -0.5 * x[0] - 0.8 * x[1] + excitation * rng.uniform(-1, 1)
        xs.append(x)
        us.append([u])
        x = A @ x + B @ [u] + rng.uniform(-1, 1, 2) * D
    return np.array(xs), np.array(us)


def written(path: Path, x: Array, u: Array, separator: str = ",") -> Path:
    lines = ["# a cart", separator.join(["time", "position", "speed", "force"])]
    for k, (state, force) in enumerate(zip(x.tolist(), u.tolist(), strict=True)):
        lines.append(separator.join(f"{v:.12g}" for v in (0.1 * k, *state, *force)))
    path.write_text("\n".join(lines) + "\n")
    return path


def fitted(capsys: pytest.CaptureFixture[str], *argv: str) -> dict[str, Any]:
    assert main(["fit", *argv, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize("kind", ["comma", "semicolon", "matlab"])
def test_a_recording_becomes_a_scenario_that_carries_keys(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x, u = recorded(3)
    path = tmp_path / "cart.csv"
    columns = COLUMNS
    if kind == "matlab":
        path = tmp_path / "cart.mat"
        savemat(str(path), {"x": x, "force": u[:, 0]})
        columns = ["--states", "x_1,x_2", *COLUMNS[2:]]
    else:
        written(path, x, u, "," if kind == "comma" else ";")
    out = tmp_path / "cart.toml"
    found = fitted(capsys, str(path), *columns, "-o", str(out))
    errors = np.array(found["standard_errors"])
    assert (np.abs(np.array(found["A"]) - A) < 5 * errors[:, :2]).all()
    assert (np.abs(np.array(found["B"]) - B) < 5 * errors[:, 2:]).all()
    assert (np.array(found["half_widths"]) > 0.98 * D).all()
    assert (np.array(found["half_widths"]) < 1.15 * D).all()
    assert found["warnings"] == []
    assert list(bare_figures(found)) == []
    text = out.read_text()
    assert f"{found['exceeded']} of {found['steps']['held_out']} steps held out did" in text
    scenario = load_scenario(out)
    assert scenario.defender.disturbance.half_widths == pytest.approx(found["half_widths"], 1e-5)
    assert run(design(scenario), steps=300, seed=1).agreements.sum() > 20


def test_an_interrupted_recording_loses_the_steps_beside_the_gap(tmp_path: Path) -> None:
    x, u = recorded(1, steps=50)
    x[20, 1] = np.nan
    path = written(tmp_path / "gap.csv", x, u)
    path.write_text(path.read_text().replace("nan", ""))
    recording = read_recording(path, ["position", "speed"], ["force"])
    assert len(recording.x) == len(recording.u) == len(recording.after) == 47
    assert np.isfinite(recording.after).all()


def test_an_operating_point_that_was_not_subtracted_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x, u = recorded(2)
    path = written(tmp_path / "cart.csv", x, u + 3.0)
    found = fitted(capsys, str(path), *COLUMNS, "-o", str(tmp_path / "cart.toml"))
    assert any("subtract the operating point" in line for line in found["warnings"])


def test_residuals_that_depend_on_their_neighbours_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bound counts steps as independent."""
    rng = np.random.default_rng(5)
    x, u = recorded(5, excitation=1.0)
    slow = np.repeat(rng.uniform(0.2, 1.0, 100), 20)[:, None]
    steps = rng.uniform(-1, 1, (2000, 2)) * D * slow * 5
    state = np.zeros(2)
    for k in range(2000):
        x[k] = state
        state = A @ state + B @ u[k] + steps[k]
    path = written(tmp_path / "cart.csv", x, u)
    found = fitted(capsys, str(path), *COLUMNS, "-o", str(tmp_path / "cart.toml"))
    assert any("fewer steps are independent" in line for line in found["warnings"])


HEAD = "position,speed,force\n"
STEP = HEAD + "1,2,3\n"


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("", [], "cart.csv: expected a line of names"),
        (HEAD + "1,2,x\n", [], "cart.csv: line 2: force: got 'x', expected a numb"),
        (HEAD + "1,2\n", [], "cart.csv: line 2: got 2 columns, expected 3"),
        (HEAD + '1,2,"3\n4"\n', [], "force: got '3\\n4', expected a number"),
        ("position,speed\n1,2\n", [], "has no column 'force', expected one of: position, speed"),
        ("position,position,speed,force\n1,2,3,4\n", [], "has two columns 'position'"),
        (HEAD + "1,2,3\n" * 4, [], "got 1 steps to identify A and B"),
        (HEAD + "1,2,3\n" * 40, [], "input force is 3 throughout"),
        (STEP, ["--sessions", "100"], "--sessions: is for a plant that is run"),
        (STEP, ["--violation", "2"], "--violation: got 2, expected"),
        (STEP, ["--period", "-1"], "--period: got -1, expected more"),
        (STEP, ["--inputs", "force,,"], "expected names of columns"),
        (STEP, ["--inputs", "speed"], "'speed' is named twice"),
        (STEP, ["--states", "a,b,c,d,e"], "got 5 and 1, expected 1 to 4"),
    ],
)
def test_what_is_no_recording_is_one_line(
    text: str, options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cart.csv"
    path.write_text(text)
    out = tmp_path / "out.toml"
    assert main(["fit", str(path), *COLUMNS, "-o", str(out), *options]) in (1, 2)
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert said in err
    assert not out.exists()


def test_a_loop_that_nothing_excites_cannot_tell_a_from_b(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "cart.csv", *recorded(4, excitation=0.0))
    assert main(["fit", str(path), *COLUMNS, "-o", str(tmp_path / "x.toml")]) == 1
    said = capsys.readouterr().err
    assert "input force follows from the states" in said
    assert "random part" in said
