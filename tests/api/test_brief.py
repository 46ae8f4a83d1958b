"""What a notebook shows of the library's objects, and what it says of wrong arguments."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from protocol.brief import Brief
from tests.support.recorded_pair import RecordedPair
from wyner import Simulated, check, design, draw_states, run
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


def test_values_are_escaped_and_cut() -> None:
    class Odd(Brief):
        def brief(self) -> dict[str, object]:
            return {"a": "<b>\n" + "c" * 100}

    assert "<td>&lt;b&gt; cc" in Odd()._repr_html_()
    assert len(repr(Odd())) < 80


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda r: run(r.system, message="hi"), "message: got str, expected bytes"),  # type: ignore[arg-type]
        (lambda r: run(r.system, steps=10.5), "steps: got 10.5, expected a whole number, 1 or"),  # type: ignore[arg-type]
        (lambda r: run(r.system, runs=0), "runs: got 0, expected a whole number, 1 or more"),
        (lambda r: run(r.system, seed=-1), "seed: got -1, expected a whole number, 0 or more"),
        (lambda r: r.frame(2), "run: got 2, expected 0 to 1"),
        (lambda r: r.system.corners(999), "i: got 999, expected 0 to 250"),
        (lambda r: r.system.index([0.0]), "x: got 1 numbers, expected 2"),
        (lambda r: draw_states(r, None, run=5), "run: got 5, expected 0 to 1"),  # type: ignore[arg-type]
    ],
)
def test_wrong_arguments_are_told_in_a_line(
    runs: Simulated, call: Callable[[Any], object], says: str
) -> None:
    """A negative seed took all memory there was."""
    with pytest.raises(ValueError, match=says) as raised:
        call(runs)
    assert "\n" not in str(raised.value)


def test_a_frame_without_pandas_says_how_to_get_it(
    runs: Simulated, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"frame\(\): needs pandas: .* -m pip install pandas"):
        runs.frame()
