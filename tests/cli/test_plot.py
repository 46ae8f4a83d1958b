"""``wyner sweep --plot``: what stands on the axes, and what cannot be drawn."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.support.scenarios import text_of
from wyner.cli.main import main
from wyner.drawing.rows import draw_rows, in_words

HEAD = "scenario,variant,secrecy.alpha,runs,steps,bits_per_second,tap keys known"


def rows_file(folder: Path, *rows: str) -> Path:
    path = folder / "s-rates.csv"
    path.write_text("\n".join([HEAD, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("bits_per_second", "message rate (bit/s), which is not secrecy"),
        ("plant.period_s", "plant.period_s"),
        ("text keys known", "text keys known, share"),
    ],
)
def test_an_axis_is_in_words_with_its_unit(column: str, words: str) -> None:
    assert in_words(column) == words


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_curve_on_the_bound_is_seen(share: float) -> None:
    """The homework's figure showed nothing: all values lay on the frame."""
    one = {"scenario": "s", "variant": "", "runs": 1, "steps": 2, "k keys known": share}
    rows = [{**one, "a": x} for x in (1, 2, 3)]
    figure = Figure()
    draw_rows(figure, rows, ["a"], "a", ["k keys known"])
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert low < -0.04
    assert high > 1.04
    assert axes.get_ylabel() == "k keys known, share"


def test_a_pdf_embeds_fonts_that_publishers_take(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = rows_file(tmp_path, "s,,1.0,5,10,2.0,0.5", "s,,2.0,5,10,3.0,0.5")
    assert main(["sweep", str(rows), "--plot", str(tmp_path / "a.pdf")]) == 0
    raw = Path(capsys.readouterr().out.strip()).read_bytes()
    assert b"/TrueType" in raw or b"/CIDFontType2" in raw
    assert b"/Type3" not in raw


def test_two_points_that_nothing_tells_apart_are_no_curve(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = rows_file(tmp_path, "s,,1.0,5,10,2.0,0.5", "s,,1.0,5,10,9.0,0.5")
    assert main(["sweep", str(rows), "--plot"]) == 2
    assert capsys.readouterr().err == (
        "wyner: --plot: secrecy.alpha: two points at 1, and nothing in the rows tells them apart: "
        "sweep them again, or leave one out\n"
    )
    assert not rows.with_suffix(".png").exists()


def test_two_scenario_files_of_one_name_are_two_curves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sweep's rows say of which file they are; they were drawn as one zigzag."""
    text = text_of("sustained")
    for name, wide in (("one", "0.1, 0.1"), ("two", "0.05, 0.05")):
        changed = text.replace("half_widths = [0.1, 0.1]", f"half_widths = [{wide}]")
        (tmp_path / f"{name}.toml").write_text(changed)
    sweep, rows = tmp_path / "s.toml", tmp_path / "s.csv"
    sweep.write_text(
        'name = "s"\nscenario = ["one.toml", "two.toml"]\nruns = 2\nsteps = 30\nseed = 7\n'
        '[grid]\n"secrecy.alpha" = [3.0, 8.0]\n'
    )
    assert main(["sweep", str(sweep), "--output", str(rows), "--jobs", "1"]) == 0
    assert "one.toml" in capsys.readouterr().out
    for path in (rows, tmp_path / "s-rates.csv"):
        assert path.read_text().splitlines()[0].split(",").count("file") == 1
        assert main(["sweep", str(path), "--plot", str(tmp_path / "s.svg")]) == 0
