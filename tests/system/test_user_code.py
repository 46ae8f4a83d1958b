"""A user's file is trusted code: one that never returns, or ends its process, is told in a line."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.programs import ROOT, wyner
from tests.support.scenarios import text_of

pytestmark = pytest.mark.slow

LAW = """
import os, time
from controller_service.laws.base import ProgramLaw
from protocol.scenario import Control

class Table(Control):
    pass

class Law(ProgramLaw):
    table = Table
    asked = 0

    def answers(self, x, i):
        self.asked += 1
        if self.asked > 20:
            {what}
        return super().answers(x, i)
"""
PLANT = """
import time

def f(t, x, u):
    while t > 1.0: time.sleep(0)
    return (x[1], u[0] - 0.5 * x[1])
"""
SOON = """
import runtime.turn_watch
runtime.turn_watch.TICK_S = 0.1
"""
LOOPS = "while True: time.sleep(0)"
ENDS = "os._exit(0)"


def up(
    folder: Path, old: str, own: str, secrecy: str = "[secrecy]"
) -> subprocess.CompletedProcess[str]:
    """A run of the scenario with ``old`` in it replaced; the watch is ten times as impatient."""
    (folder / "sitecustomize.py").write_text(SOON)
    text = text_of("sustained", (old, own), ("[secrecy]", secrecy))
    (folder / "own.toml").write_text(text)
    options = ("--scenario", "own.toml", "--pace", "fast", "--run-dir", "run")
    return wyner("up", *options, cwd=folder, env={**os.environ, "PYTHONPATH": f"{folder}:{ROOT}"})


@pytest.mark.parametrize(("what", "why"), [(LOOPS, "has not returned for 3 s"), (ENDS, "")])
def test_a_law_that_does_not_return_ends_the_run_with_a_line(
    what: str, why: str, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(LAW.format(what=what))
    done = up(tmp_path, 'law = "sustained"', 'law = "mine.py:Law"')
    assert done.returncode == 1, done.stderr
    line = done.stderr.splitlines()[-1]
    assert line.startswith("wyner: controller: ")
    if why:
        assert "mine.py, line 16, in answers has not returned for 3 s" in line
    else:
        assert "its process ended in the middle of the run, with exit code 0" in line
    assert "run/controller/log)" in line


def test_a_plant_that_does_not_return_ends_the_run_with_a_line(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(PLANT)
    text = text_of("sustained")
    matrices = "".join(line for line in text.splitlines(True) if line[:3] in ("A =", "B ="))
    own = '[plant]\nkind = "ode"\nobject = "mine.py:f"\n'
    done = up(tmp_path, f"[plant]\n{matrices}", own, f"[defender]\n{matrices}\n[secrecy]")
    assert done.returncode == 1, done.stderr
    line = done.stderr.splitlines()[-1]
    assert line.startswith("wyner: plant: mine.py, line 5, in f has not returned for 3 s; "), line
