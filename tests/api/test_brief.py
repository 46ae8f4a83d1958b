"""What a notebook shows of the library's objects, and what it says of wrong arguments."""

import sys
from pathlib import Path

import pytest

from protocol.brief import Brief
from tests.support.recorded_pair import RecordedPair
from wyner import Simulated, check, design, run
from wyner.simulate.engine import follow


@pytest.fixture(scope="module")
def runs() -> Simulated:
    return run(design("sustained"), steps=60, runs=2, message=b"hi")


def objects(runs: Simulated, folder: Path) -> list[Brief]:
    RecordedPair(folder, b"hi").stop()
    s = runs.system
    scenario = s.scenario
    found = [s, runs, scenario, s.design, runs.record, runs.link, scenario.knowledge()]
    return [*found, follow(runs.record, [2.0, 8.0]), *check(folder)]


def test_each_is_a_line_and_a_small_table(runs: Simulated, tmp_path: Path) -> None:
    """``repr(design("sustained"))`` had 6.6 million characters."""
    for one in objects(runs, tmp_path):
        text, html = repr(one), one._repr_html_()
        assert text.startswith(f"{type(one).__name__}(")
        assert len(text) < 250
        assert "\n" not in text
        assert html.startswith("<table>")
        assert len(html) < 1500
    assert repr(runs.system).startswith("System(scenario=sustained, law=sustained, states=2")
    assert "agreements=" in repr(runs)


def test_a_frame_without_pandas_says_how_to_get_it(
    runs: Simulated, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"frame\(\): needs pandas: .* -m pip install pandas"):
        runs.frame()
