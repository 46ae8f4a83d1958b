"""Every rate and probability of every ``--json`` has its interval, or says why it has none.

`fit`, `send` and `up --demo` are looked at where they are run: tests/fit/test_fit.py, test_send.py,
test_demo.py.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from runtime.run_folder import SUMMARY
from tests.support.bare_figures import bare_figures
from tests.support.checked_runs import keyed_run
from tests.support.rehearsal import Rehearsal
from wyner.cli.main import main
from wyner.dashboard.headless import COUNTED, Reporter
from wyner.dashboard.model import LoopState, reduce_all
from wyner.runs.score.attacked import NO_INTERVAL


def said(capsys: pytest.CaptureFixture[str], *argv: str) -> Any:
    main([*argv, "--json"])
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    "argv",
    [
        ("design", "packed"),
        ("design", "paper"),
        pytest.param(("design", "network"), marks=pytest.mark.long, id="design network"),
        ("design",),
    ],
    ids=" ".join,
)
def test_of_a_design(capsys: pytest.CaptureFixture[str], argv: tuple[str, ...]) -> None:
    assert list(bare_figures(said(capsys, *argv))) == []


@pytest.mark.slow
def test_of_a_sweep_of_few_runs_and_of_enough(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for runs in (2, 8):
        grid = tmp_path / f"grid-{runs}.toml"
        grid.write_text(
            f'name = "few"\nscenario = "paper"\nsteps = 50\nseed = 1\nruns = {runs}\n'
            '[grid]\n"secrecy.alpha" = [2.0, 8.0]\n'
        )
        told = said(capsys, "sweep", str(grid), "--output", str(tmp_path / f"{runs}.csv"))
        assert len(told["points"]) == 2
        assert list(bare_figures(told)) == []


@pytest.mark.slow
@pytest.mark.integration
def test_of_a_live_run_and_of_what_looks_at_it(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(shutil.copytree(keyed_run(tmp_path_factory), tmp_path / "run"))
    summary = json.loads((Path(run) / SUMMARY).read_text(encoding="utf-8"))
    assert summary["taps"]
    assert summary["keys"] is not None
    again = [str(shutil.copytree(run, tmp_path / f"run-{i}")) for i in range(5)]
    for told in (
        summary,
        said(capsys, "score", run),
        said(capsys, "score", *again),
        said(capsys, "check", run),
        said(capsys, "status", run),
    ):
        assert list(bare_figures(told)) == []


def test_of_an_attack_and_its_options() -> None:
    """The demo told the ghost's share of the corner as if it had been measured."""
    attack = {"kind": "ghost", "onset": 5, "options": {"share": 1.0}}
    assert list(bare_figures(attack))
    assert list(bare_figures(attack | NO_INTERVAL)) == []


def test_lines_in_a_pipe_say_once_what_their_figures_rest_on() -> None:
    state, reporter = LoopState(), Reporter()
    told: list[str] = []
    for step, batch in enumerate(Rehearsal().arrivals(400)):
        state = reduce_all(state, batch)
        lines = reporter.report(state, step * 1_000_000_000)
        told += lines
    figures = [line for line in told if "bit/s" in line and line != COUNTED]
    assert len(figures) > 2
    assert told.count(COUNTED) == 1
    assert told.index(COUNTED) < told.index(figures[0])
