"""`wyner design --alphas`: a table, an object, a figure, and one line for what is wrong."""

import json
from pathlib import Path

import pytest

from wyner.cli.main import main


def test_the_table_names_bits_and_what_is_left_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "packed", "--alphas", "3,3.01,8"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "leaves 0 bits" in lines[1]
    rows = [line.split() for line in lines if line.strip()[:1].isdigit()]
    assert [(row[0], row[1], row[2]) for row in rows] == [
        ("3", "1", "0.000"),
        ("3.01", "2", "1.000"),
        ("8", "4", "2.000"),
    ]


def test_the_object_has_every_column(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "packed-quadruple-tank", "--alphas", "8", "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    (row,) = table["alphas"]
    assert (row["candidates"], row["bits_per_step"], row["bound_candidates"]) == (16, 4.0, 16)
    assert row["bits_per_second"] == pytest.approx(0.8)
    assert len(table["price"]["state"]) == 2


def test_the_figure_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "capacity.svg"
    assert main(["design", "packed", "--alphas", "2,8", "--plot", str(path)]) == 0
    assert path.read_text().startswith("<?xml")
    assert capsys.readouterr().out.rstrip().endswith(str(path))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--alphas", "0.5"], "--alphas: got '0.5', expected numbers from 1 to 1000"),
        (["--alphas", "x"], "--alphas: got 'x'"),
        (["--alphas", "--plot", "a.pdf"], "--plot: got 'a.pdf', expected a name in .svg or .png"),
    ],
)
def test_wrong_arguments_are_one_line(
    arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", "packed", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert line in captured.err
    assert captured.err.count("\n") == 1
