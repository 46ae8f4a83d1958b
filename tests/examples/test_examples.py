"""Every example runs as it stands, and says what its words promise."""

import json
import re
import runpy
import shutil
import sys
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from wyner.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
ELSEWHERE = {"lesson"}
"""A page (`test_lesson.py`)."""
PROGRAMS = sorted(path for path in (ROOT / "examples").glob("*.py") if path.stem not in ELSEWHERE)
LONG = {"whole_messages", "ladder_of_eavesdroppers"}
"""One decodes twenty messages, in the other an eavesdropper learns."""

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))

SAYS = {
    "first_run": "nearest-centre had 100% of the key symbols right",
    "ladder_of_eavesdroppers": "oracle           100.0%",
    "rate_against_alpha": "wrote rate.png",
    "one_step": "wrote step.png",
    "own_scenario": "control.inputs: got shape 2, expected 1",
    "own_eavesdropper": "speed-watcher",
    "data_frame": "True",
    "certificate": "none of 1000 sessions left D_c: at most 0.0069, confidence 0.999",
    "gymnasium_plant": "recovered [b'gym']",
    "lossy_network": "the plant has [b'first', b'second']",
    "modbus_plant": "150 of 150 tested steps agreed; recovered [b'tank']",
    "own_plant": "250 of 250 tested steps agreed, 10.0 bit/s",
    "paper_scheme": "nearest-centre names 178 of 178 key bits",
    "whole_messages": "list-decoder reads 20 of 20 messages",
    "packed_law": "expected at most 4",
    "pendulum": "regulator  for ever",
}
"""A part of what each program prints."""


@pytest.fixture(autouse=True)
def quiet_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    if "matplotlib.pyplot" in sys.modules:
        import matplotlib.pyplot as plt

        plt.switch_backend("Agg")


def close_figures() -> None:
    if "matplotlib.pyplot" in sys.modules:
        import matplotlib.pyplot as plt

        plt.close("all")


def needs(text: str) -> None:
    for library in ("matplotlib", "pandas", "gymnasium", "pymodbus"):
        if library in text:
            pytest.importorskip(library)
    if ".frame(" in text:
        pytest.importorskip("pandas")


def cased(path: Path) -> Any:
    """A program as a case."""
    return pytest.param(path, id=path.stem, marks=[pytest.mark.long] * (path.stem in LONG))


@cache
def printed(path: Path) -> str:
    """What a program prints."""
    with redirect_stdout(StringIO()) as out:
        runpy.run_path(str(path), run_name="__main__")
    return out.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("path", [cased(path) for path in PROGRAMS])
def test_a_program(path: Path) -> None:
    needs(path.read_text(encoding="utf-8"))
    said = printed(path)
    close_figures()
    assert SAYS[path.stem] in said


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook(path: Path) -> None:
    """Cell after cell in one name space, as a kernel does; every assertion in it holds."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    needs("\n".join(code))
    assert len(code) >= 5
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, source in enumerate(code, start=1):
        exec(compile(source, f"{path.name}, code cell {number}", "exec"), names)
    close_figures()
    assert all(not cell.get("outputs") for cell in cells)


@pytest.mark.long
def test_the_sweep_beside_the_eavesdropper_runs(tmp_path: Path) -> None:
    text = (ROOT / "examples" / "alpha.toml").read_text(encoding="utf-8")
    assert "\nruns = 20\n" in text
    (tmp_path / "few.toml").write_text(text.replace("runs = 20", "runs = 4"), encoding="utf-8")
    shutil.copy(ROOT / "examples" / "own_eavesdropper.py", tmp_path)
    options = ["--output", str(tmp_path / "alpha.csv")]
    assert main(["sweep", str(tmp_path / "few.toml"), *options]) == 0
    rates = (tmp_path / "alpha-rates.csv").read_text(encoding="utf-8")
    assert "speed-watcher keys known" in rates
    assert len(rates.splitlines()) == 4


def test_there_are_a_dozen_programs_and_three_notebooks() -> None:
    assert {path.stem for path in PROGRAMS} == set(SAYS)
    assert len(PROGRAMS) >= 12
    assert len(NOTEBOOKS) == 3


README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("code", "printed"),
    re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```", README, re.DOTALL),
    ids=("packed", "own"),
)
def test_the_readmes_programs_print_what_stands_below_them(
    code: str, printed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out == printed


@pytest.mark.slow
def test_the_guides_program_runs(capsys: pytest.CaptureFixture[str]) -> None:
    guides = (ROOT / "docs" / "guides.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(from wyner .*?)```", guides, re.DOTALL)
    exec(compile(code, "guides.md", "exec"), {})
    assert "We sail at dawn." in capsys.readouterr().out


def test_the_readme_has_the_numbers_of_the_papers_example() -> None:
    out = printed(ROOT / "examples" / "paper_scheme.py")
    rates = re.findall(r": (\S+ \[\S+, \S+\]) bit/s", out)
    named = re.findall(r"nearest-centre names (\d+ of \d+)", out)
    for rate, keys in zip(rates, named, strict=True):
        assert f"| {rate} | {keys} |" in README
    assert len(named) == 3
