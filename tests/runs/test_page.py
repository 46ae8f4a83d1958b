"""The page of a run: whole, self-contained, escaped, and drawn to scale."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from runtime.run_folder import PLANT_TRACE
from tests.support.recorded_pair import RecordedPair, edit
from wyner.cli.main import main
from wyner.drawing.run import LONG, draw_keys, draw_over_time
from wyner.drawing.style import drawing
from wyner.runs.page import write_report

SECRET = b"Hi"
HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "run"
    small = RecordedPair(folder, SECRET, HOSTILE.encode())
    small.until_received(1)
    small.steps(20, {5: "offer lost"})
    small.stop()
    return folder


@pytest.fixture(scope="module")
def text(run_dir: Path) -> str:
    return write_report(run_dir).read_text(encoding="utf-8")


def test_it_is_one_whole_page_that_needs_nothing_else(text: str) -> None:
    links = re.findall(r'\b(?:src|href|srcset|action)="([^",]*)', text)
    assert links == ["data:image/svg+xml;base64"] * 2
    for foreign in ("<script", "url(", "@import"):
        assert foreign not in text
    assert text.count("<h2>") == 5
    assert text.endswith("</html>")


def test_what_was_sent_is_shown_and_cannot_act(text: str) -> None:
    assert "<pre>Hi</pre>" in text
    assert HOSTILE not in text
    assert "&lt;script&gt;" in text


def test_the_verdict_comes_first(text: str) -> None:
    headings = re.findall(r"<h2>(.*?)</h2>", text)
    assert "claim" in headings[0] or "secret" in headings[0]
    assert "PASS" in text.partition("<h2>")[0]


def test_it_says_what_the_check_says(
    run_dir: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["check", "--json", str(run_dir)])
    found = json.loads(capsys.readouterr().out)
    passed = sum(c["result"] == "PASS" for c in found["rules"])
    assert f"{passed} PASS, 0 FAIL" in text
    for rule in found["rules"]:
        assert f"<td>{rule['name']}</td>" in text


def test_states_are_drawn_where_they_were_and_a_long_line_as_its_range() -> None:
    x = np.sin(np.arange(100.0))
    long = np.where(np.arange(20_000) % 2, 1.0, -1.0) * (np.arange(20_000) % 97)
    for values in (x, long):
        with drawing((6, 3)) as figure:
            axes = figure.subplots()
            time_s = 0.1 * np.arange(len(values))
            draw_over_time(axes, time_s, {"x1": values}, agreed_s=time_s[:3], flags=[(1.0, "a")])
            lines = [np.asarray(x.get_xydata()) for x in axes.lines if x.get_label() == "x1"]
            bands = [band.get_paths()[0].get_extents() for band in axes.collections]
        if values is x:
            assert np.array_equal(np.array(lines), [np.column_stack([time_s, x])])
        else:
            assert not lines
            assert [(band.ymin, band.ymax) for band in bands] == [(-96.0, 96.0)]


def test_keys_are_counted_up_to_the_last_also_of_a_long_run() -> None:
    agreed_s, right = np.arange(9_000.0), np.arange(9_000) % 3 == 0
    with drawing((6, 3)) as figure:
        axes = figure.subplots()
        draw_keys(axes, agreed_s, {"right, t": right})
        both = np.array([line.get_xydata() for line in axes.lines])
    assert both.shape == (2, LONG, 2)
    assert both[:, -1].tolist() == [[8_999.0, 9_000.0], [8_999.0, 3_000.0]]


def test_without_a_tap_it_says_so(text: str) -> None:
    assert "Not known: " in text
    assert "beliefs" in text


def test_a_failed_check_is_shown_as_failed(tmp_path: Path, run_dir: Path) -> None:
    broken = Path(shutil.copytree(run_dir, tmp_path / "broken"))
    edit(broken / PLANT_TRACE, lambda lines: lines[30].update(x_next=[5.0, 5.0]))
    page = write_report(broken, tmp_path / "page.html").read_text()
    assert "<tr><td>FAIL</td><td>plant</td>" in page


def test_the_command_prints_the_path_and_refuses_what_is_no_run(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(run_dir), "--output", str(tmp_path / "a.html")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'a.html'}\n"
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"wyner: {tmp_path}: no run here, expected scenario.toml\n"
