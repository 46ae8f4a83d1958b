"""Who looks at a run holds some bytes a step of it: 400 MB for a million steps, with keys."""

import json
from pathlib import Path

import pytest

from runtime.recording import LineWriter, decode, dumps, raw_lines
from runtime.run_folder import BELIEFS, CAPTURE, GUESSES
from tests.support.programs import python
from tests.support.recorded_pair import make_run
from tests.support.size import size
from wyner.runs.run import Run

pytestmark = pytest.mark.long

FEW, MANY = 8_000, size(40_000, 120_000)
MOST = 400 * 2**20

SUMMARY = """
from wyner.runs.run import Run
from wyner.runs.score.summary import summarise
code = 0 if summarise(Run.load(sys.argv[1]), b"")["steps"] else 1
"""
COMMAND = """
from wyner.cli.main import main
code = main(["{0}", sys.argv[1]])
"""
EXPORT = """
from wyner.cli.main import main
code = main(["report", "--steps", "--output", sys.argv[1] + "/steps.csv", sys.argv[1]])
"""
HIGHEST = """
with open("/proc/self/status") as status:
    print(next(line for line in status if line.startswith("VmHWM")), file=sys.stderr)
sys.exit(code)
"""
"""What a process took at most; what `wait4` says of a child begins with what its parent has."""

READERS = {
    "summary": SUMMARY,
    "score": COMMAND.format("score"),
    "check": COMMAND.format("check"),
    "report": COMMAND.format("report"),
    "export": EXPORT,
}


def guessed(folder: Path, steps: int, scenario: str) -> Path:
    """A run with an eavesdropper who guesses each step."""
    make_run(folder, steps, scenario)
    trace = Run.load(folder).columns("plant")
    made = [trace.where(row) for row in trace.rows if row["j"] >= 0]
    header = next(raw_lines(folder / CAPTURE))[1]
    writer = LineWriter(folder / GUESSES, decode(header) or {})
    for session, k in made:
        at = {"name": "t", "session": session, "k": k}
        writer.append(dumps({"event": "guess", **at, "symbol": 0, "p": 1, "agreed": 1}))
    writer.close()
    record = {
        "name": "t", "session": made[-1][0], "failed": "", "message": "", "whole": [],
        "whole_count": 0, "candidates_left": 0, "solved_k": -1, "confidence": 0.0, "symbols": [],
    }  # fmt: skip
    (folder / BELIEFS).write_text(json.dumps({"t": record}))
    return folder


def peak(name: str, folder: Path) -> int:
    """Bytes that a process takes at most over a run."""
    code = f"import sys{READERS[name]}{HIGHEST}"
    done = python("-c", code, folder, timeout=None)
    return 1024 * int(done.stderr.split()[-2])


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("keyed")
    return guessed(folder / "few", FEW, "keys"), guessed(folder / "many", MANY, "keys")


@pytest.mark.parametrize("name", READERS)
def test_a_million_steps_with_keys_take_400_mb_at_most(keyed: tuple[Path, Path], name: str) -> None:
    """By what each step more takes.

    One process takes some megabytes more or less than another, which over so many steps are tens of
    a million: what the reader needs is the least of a few.
    """
    few, many = keyed
    least = min(peak(name, few) for _ in range(2))
    found = []
    for _ in range(4):
        found.append(least + (peak(name, many) - least) / (MANY - FEW) * 1_000_000)
        if found[-1] <= MOST:
            return
    assert min(found) <= MOST
