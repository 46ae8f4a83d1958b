"""What the check of a run, or of every loop of a fleet, found."""

from dataclasses import dataclass
from pathlib import Path

from runtime.run_folder import loops_below
from wyner.printout import Printout
from wyner.runs.check import RuleResult, counts, judge
from wyner.runs.check.evidence import read_evidence
from wyner.runs.seal import READ, SEAL_ALONE, is_sealed


@dataclass(frozen=True, eq=False)
class Checked(Printout):
    """How a run, or each run of a fleet, did by each rule.

    Parameters
    ----------
    failed : list of RuleResult
        The rules that are broken.
    """

    failed: list[RuleResult]


def check_run(run_dir: Path) -> Checked:
    """Judge a run that has ended by every rule, or each loop below a fleet's folder.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError, UsageError
        When there is no run, it cannot be read, or it goes on.
    """
    loops = {folder.name: _checked(folder) for folder in loops_below(run_dir)}
    if not loops:
        return _checked(run_dir)
    lines = []
    for name, loop in loops.items():
        lines.append(f"{name}: {loop.lines[-1]}")
        lines += [f"  {line}" for result in loop.failed for line in str(result).splitlines()]
    failed = [result for loop in loops.values() for result in loop.failed]
    figures = {
        "run_dir": str(run_dir),
        "passed": not failed,
        "loops": [loop.figures for loop in loops.values()],
    }
    well = sum(not loop.failed for loop in loops.values())
    return Checked(figures, [*lines, f"{well} of {len(loops)} loops PASS"], failed)


def _checked(folder: Path) -> Checked:
    e = read_evidence(folder)
    results = judge(e)
    failed = [result for result in results if result.result == "FAIL"]
    figures = {
        "run_dir": str(folder),
        "passed": not failed,
        "failed": len(failed),
        "skipped": sum(result.result == "SKIP" for result in results),
        "sealed": is_sealed(e.run.manifest),
        "rules": [result.as_json() for result in results],
        "files": [*READ, *SEAL_ALONE],
    }
    return Checked(figures, [*map(str, results), counts(results)], failed)
