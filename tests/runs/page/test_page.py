"""The page of a run: whole, self-contained, escaped, and drawn to scale."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tap_service.eavesdroppers.base import Belief
from tests.support.patience import PATIENCE_S
from tests.support.small_run import SmallRun
from wyner.cli.main import main
from wyner.runs.page import write_report
from wyner.runs.page.chart import (
    COLUMNS,
    DENSE,
    MOST_POINTS,
    Curve,
    Series,
    band,
    chart,
    ticks,
)

SECRET = b"Hi"
BELIEF = Belief()
HOSTILE = "<script>alert(1)</script>"


class Outline(HTMLParser):
    """Tags that were opened, whether they are balanced, where links lead, and what has a name."""

    EMPTY = frozenset({"meta", "path", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.links: list[str] = []
        self.names: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.links += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "action")]
        self.names += [v or "" for k, v in attrs if k == "id"]
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in self.EMPTY:
            return
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "run"
    small = SmallRun(folder, (SECRET, HOSTILE.encode()))
    small.until_received(1)
    small.steps(20, {5: "offer lost"})
    small.close()
    return folder


@pytest.fixture(scope="module")
def text(run_dir: Path) -> str:
    return write_report(run_dir).read_text(encoding="utf-8")


def test_it_is_one_whole_page_that_needs_nothing_else(text: str) -> None:
    outline = Outline()
    outline.feed(text)
    assert outline.open == []
    assert outline.links == []
    assert "script" not in outline.seen
    assert "url(" not in text
    assert "@import" not in text
    assert text.count("<h2>") == 6


def test_what_was_sent_is_shown_and_cannot_act(text: str) -> None:
    assert "<pre>Hi</pre>" in text
    assert HOSTILE not in text
    assert "&lt;script&gt;" in text


def test_the_verdict_comes_first(text: str) -> None:
    headings = re.findall(r"<h2>(.*?)</h2>", text)
    assert "claim" in headings[0] or "secret" in headings[0]
    assert "PASS" in text.partition("<h2>")[0]


def test_a_long_line_is_drawn_as_its_range() -> None:
    points = [(float(i), float((-1) ** i * (i % 97))) for i in range(20000)]
    outline = band(points)
    assert len(outline) == 2 * COLUMNS
    assert max(y for _, y in outline) == 96.0
    assert min(y for _, y in outline) == -96.0
    picture = chart("t", [Curve("a", points, banded=True)], "x", "y")
    assert picture.count('class="band"') == 1
    assert 'class="band"' not in chart("t", [Curve("a", points[:DENSE], banded=True)], "x", "y")


def test_it_says_what_the_check_says(
    run_dir: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["check", "--json", str(run_dir)])
    found = json.loads(capsys.readouterr().out)
    passed = sum(c["result"] == "PASS" for c in found["rules"])
    assert f"{passed} PASS, 0 FAIL" in text
    for rule in found["rules"]:
        assert f"<td>{rule['name']}</td>" in text


def test_states_are_drawn_where_they_were(run_dir: Path, text: str) -> None:
    events = [json.loads(x) for x in (run_dir / "plant/trace.jsonl").read_text().splitlines()]
    x1 = [e["x"][0] for e in events if e["event"] in ("transition", "missed")]
    picture = text.partition('aria-label="States over time"')[2].partition("</svg>")[0]
    first = re.findall(r'class="line"[^>]* d="M([^"]+)"', picture)[0]
    drawn = [float(part.split()[1]) for part in first.split("L")]
    assert len(drawn) == len(x1) <= MOST_POINTS
    # One affine map takes every state to its height on the page, upside down.
    i, j = x1.index(min(x1)), x1.index(max(x1))
    scale = (drawn[j] - drawn[i]) / (x1[j] - x1[i])
    assert scale < 0
    for value, y in zip(x1, drawn, strict=True):
        assert y == pytest.approx(drawn[i] + scale * (value - x1[i]), abs=0.02)


def test_without_a_tap_it_says_so(text: str) -> None:
    assert "Not known: " in text
    assert "beliefs" in text


def test_a_failed_check_is_shown_as_failed(tmp_path: Path, run_dir: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(run_dir, broken)
    trace = broken / "plant" / "trace.jsonl"
    lines = trace.read_text().splitlines()
    event = json.loads(lines[30])
    event["x_next"][0] += 5.0
    lines[30] = json.dumps(event)
    trace.write_text("\n".join(lines) + "\n")
    page = write_report(broken, tmp_path / "page.html").read_text()
    assert "<tr><td>FAIL</td><td>plant</td>" in page


def test_the_command_prints_the_path_and_refuses_what_is_no_run(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(run_dir), "--output", str(tmp_path / "a.html")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'a.html'}\n"
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"wyner: {tmp_path}: no run here, expected scenario.toml\n"


# --- charts ---------------------------------------------------------------------------------------


def test_ticks_are_round_and_inside() -> None:
    assert ticks(0.0, 10.0) == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert ticks(-0.13, 0.22, 4) == pytest.approx([-0.1, 0.0, 0.1, 0.2])
    assert ticks(3.0, 3.0) == [3.0]


def test_a_long_line_keeps_its_peaks() -> None:
    points = [(float(i), 0.0) for i in range(20000)]
    points[777] = (777.0, 5.0)
    short = Series(points).points()
    assert len(short) <= 2 * MOST_POINTS
    assert (777.0, 5.0) in short
    assert [p[0] for p in short] == sorted(p[0] for p in short)
    for count in (0, 1, MOST_POINTS, MOST_POINTS + 1, 2 * MOST_POINTS + 3):
        kept = Series((float(i), float(-i)) for i in range(count)).points()
        assert kept[:1] == [(0.0, -0.0)][:count]
        assert kept[-1:] == [(count - 1.0, 1.0 - count)][:count]
        assert len(kept) == count or count > MOST_POINTS


def test_labels_are_escaped_and_empty_charts_are_drawn() -> None:
    picture = chart("<t>", [Curve("<a>", [])], "<x>", "<y>")
    assert "<t>" not in picture
    assert "&lt;a&gt;" in picture


# --- in a browser ---------------------------------------------------------------------------------

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


@pytest.mark.skipif(BROWSER is None, reason="no chromium or google-chrome to look with")
def test_a_browser_shows_it_whole(run_dir: Path, tmp_path: Path) -> None:
    """Lines have their colours, text is dark on light, and nothing sticks out on the right."""
    image = pytest.importorskip("matplotlib.image")
    page = write_report(run_dir, tmp_path / "page.html")
    shot = tmp_path / "page.png"
    assert BROWSER is not None
    done = subprocess.run(
        [
            BROWSER,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
            "--window-size=800,3000",
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--screenshot={shot}",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    pixels = (image.imread(shot)[..., :3] * 255).round().astype(int)
    assert pixels.shape == (3000, 800, 3)
    for colour in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)):
        near = abs(pixels - colour).max(axis=2) <= 8
        assert near.sum() > 200, colour
    paper = pixels[0, 0]
    assert (abs(paper - pixels).max(axis=2) > 100).sum() > 5000
    assert (pixels[:, -4:] == paper).all()
