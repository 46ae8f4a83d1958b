"""Figures: those of the pages, from their data alone, with runs, seeds and intervals stated."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from protocol.statistics import normal_mean
from studies import DATA, FIGURES_FOLDER
from studies.__main__ import main
from studies.figures import FIGURES, draw
from studies.figures.loop import alpha_of, start_of, summaries
from studies.figures.rows import plain_rows
from studies.registry import origin, recorded, stale, studies
from wyner.sweeps.code import ROOT
from wyner.sweeps.grid import Row
from wyner.sweeps.results import read_table

PAGE = ROOT / "docs" / "findings.md"
PAGES = {
    "idea": ROOT / "README.md",
    "network": ROOT / "docs" / "concepts.md",
}
"""Where a figure stands that is not among the findings."""
CERTAIN = ("idea",)
"""Figures without an estimate: a single step."""


NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
NAMED_BY_CONTENT = re.compile(r"\b([mp])[0-9a-f]{10}\b")
"""Markers and clip paths in an SVG: hashes, which the last digit of a place changes."""


@pytest.mark.long
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_that_of_the_page_and_states_runs_seed_and_intervals(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page's figure was drawn by another process; another machine may round otherwise."""
    kind, notes = FIGURES[name], list[str]()
    labels: list[str] = []

    def noted(figure: Figure, data: Path) -> str:
        notes.append(kind.draw(figure, data))
        labels.extend(
            text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())
        )
        return notes[-1]

    monkeypatch.setitem(FIGURES, name, kind._replace(draw=noted))
    svg = draw(name, output=tmp_path)
    drawn, shown = (
        NAMED_BY_CONTENT.sub(r"\1", path.read_text(encoding="utf-8"))
        for path in (svg, FIGURES_FOLDER / svg.name)
    )
    assert NUMBER.split(drawn) == NUMBER.split(shown)
    places = [np.array(NUMBER.findall(text), dtype=float) for text in (drawn, shown)]
    assert np.abs(places[0] - places[1]).max() < 1e-3
    assert 5_000 < svg.stat().st_size < 200_000
    assert all("secret" in text for text in labels if "rate" in text.split())
    (note,) = notes
    if name in CERTAIN:
        assert "runs" not in note
        return
    assert re.search(r"\bruns?\b", note)
    assert re.search(r"seed 7\b|seeds \d+ to \d+", note)
    # A picture of single runs has no interval; every figure with an estimate has.
    assert ("95 %" in note) == (name != "sets")


def test_every_figure_is_in_the_document_with_its_data() -> None:
    for name, kind in FIGURES.items():
        text = PAGES.get(name, PAGE).read_text(encoding="utf-8")
        assert f"figures/{name}.svg" in text
        assert (FIGURES_FOLDER / f"{name}.svg").exists()
        for file in kind.data:
            assert f"data/{file}.csv" in text or name == "idea"
            assert (DATA / f"{file}.csv").exists()
            assert file in studies()


def figures(arguments: list[str]) -> int:
    return main(["figures", *arguments])


def test_a_wrong_name_and_missing_data_are_told_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert figures(["nothing"]) == 2
    assert "got 'nothing', expected undetected" in capsys.readouterr().err
    assert figures(["network", "--data", str(tmp_path)]) == 1
    assert figures(["rate-paper", "--data", str(tmp_path)]) == 1
    errors = capsys.readouterr().err.splitlines()
    assert errors == [
        f"wyner: {tmp_path / 'network.csv'}: cannot be read: No such file or directory",
        f"wyner: {tmp_path / 'fig7-paper.csv'}: cannot be read: No such file or directory",
    ]
    shutil.copy(DATA / "network.csv", tmp_path)
    (tmp_path / "out").write_text("in the way")
    assert figures(["network", "--data", str(tmp_path), "--output", str(tmp_path / "out")]) == 1


def test_rows_of_other_code_are_told(tmp_path: Path) -> None:
    one = studies()["network"]
    path = tmp_path / "network.csv"
    rows = recorded("network")
    path.write_text(
        "\n".join([",".join(one.head), *(",".join(row.values()) for row in rows), ""]).replace(
            rows[0]["version"], one.version
        )
    )
    assert list(stale(tmp_path)) == []
    path.write_text(path.read_text().replace(one.version, "1.0.0+00000001"))
    told = f"network.csv: {len(rows)} of {len(rows)} rows by 1.0.0+00000001 ({len(rows)}); today "
    assert list(stale(tmp_path)) == [told + one.version]


def test_a_page_says_that_its_rows_are_of_other_code() -> None:
    one = studies()["network"]
    rows = [row | {"version": one.version} for row in recorded("network")]
    hash_ = one.version.partition("+")[2]
    assert origin({"network": rows}) == f"Rows of code {hash_}."
    rows[3]["version"] = "1.0.0+00000001"
    assert origin({"network": rows}) == (
        f"Rows of code {hash_} ({len(rows) - 1}), 00000001 (1), measured with an earlier version "
        "of the code."
    )


def without_version(path: Path) -> list[Row]:
    """The rows but for the code's version, which every edit of the code changes."""
    rows = read_table(path)
    assert len({row.pop("version") for row in rows}) == 1
    return rows


@pytest.mark.parametrize("name", ["sets", "fig7-paper", "fig7-paper-20", "fig7-sustained"])
def test_the_shipped_data_are_what_the_code_gives(name: str, tmp_path: Path) -> None:
    studies()[name].measure(tmp_path / "now.csv")
    assert without_version(tmp_path / "now.csv") == without_version(DATA / f"{name}.csv")


def row_with(text: str, *cells: str) -> str:
    """The one line of a table of the document that begins with these cells."""
    start = "| " + " | ".join(cells)
    (line,) = (line for line in text.splitlines() if line.startswith(start))
    return line


def test_the_documents_numbers_are_the_datas() -> None:
    text = PAGE.read_text(encoding="utf-8").partition("\n## Attacks\n")[0]
    for s in summaries(DATA, "fig7-paper"):
        if alpha_of(s) in (1.5, 3.0, 8.0):
            cell = "{:.3f} [{:.3f}, {:.3f}]".format(*s.rate)
            assert cell in row_with(text, start_of(s).removeprefix("x(0) = "))
    for s in summaries(DATA, "sustained-long"):
        if alpha_of(s) in (1.5, 3.0, 8.0):
            assert "{:.2f} [{:.2f}, {:.2f}]".format(*s.rate) in text
    prices = text.partition("\n### Its price\n")[2]
    for s in summaries(DATA, "price"):
        kind = str(s.first["variant"])
        same = "`paper` (the same as quiet, K x in T_0)"
        named = {"sustained": "`sustained`", "paper": same, "quiet, K x in T_0": same}
        line = row_with(prices, named.get(kind, kind))
        cost = normal_mean(s.sums["state_cost"], s.sums["state_cost_squares"], s.runs)
        effort = normal_mean(s.sums["input_effort"], s.sums["input_effort_squares"], s.runs)
        assert "{:.4f} [{:.4f}, {:.4f}]".format(*cost) in line
        assert "{:.3f} [{:.3f}, {:.3f}]".format(*effort) in line
    lines = {
        "uniform": "uniform in",
        "truncated Gaussian": "Gaussian truncated",
        "sinusoid": "sinusoid",
        "constant bias": "constant",
        "corners of D": "corners of D |",
        "corners of D_c": "corners of D_c",
        "Gaussian, 3 % outside": "Gaussian, 3 %",
        "Gaussian, 41 % outside": "Gaussian, 41 %",
    }
    taps = {r["variant"]: r for r in plain_rows(DATA / "taps.csv")}
    rates = settled_rates()
    found = {
        str(s.first["variant"]): s for s in summaries(DATA, "disturbances") if alpha_of(s) == 8
    }
    for kind, start in lines.items():
        line = row_with(text, start)
        s = found[kind]
        assert f"| {rates['disturbance', kind, 8.0][0]:.2f} |" in line
        wrong = 100 * s.counts["mistaken"] / s.counts["agreements"]
        assert ("never" if wrong == 0 else f"{wrong:.2g} % of keys") in line
        assert (taps[kind]["nearest_right"] == taps[kind]["agreements"]) == ("always" in line)
    text = text.partition("# Other plants\n")[2].partition("\n#")[0]
    for (group, kind, alpha), (_, bits) in rates.items():
        if group == "plant" and alpha in (1.5, 8.0):
            name = kind.replace("-", " ")
            line = row_with(text, "paper's plant" if name == "sustained" else name)
            assert f"{bits:.3f}" in line


def settled_rates() -> dict[tuple[str, str, float], tuple[float, float]]:
    """Bit/s and bits a step of each settled loop, the mean from both starts."""
    found: dict[tuple[str, str, float], list[tuple[float, float]]] = {}
    for row in plain_rows(DATA / "settled.csv"):
        bits, key = row["bits"], (row["group"], row["name"], row["alpha"])
        found.setdefault(key, []).append((bits / row["period_s"], bits))
    return {
        key: (sum(a for a, _ in rates) / len(rates), sum(b for _, b in rates) / len(rates))
        for key, rates in found.items()
    }
