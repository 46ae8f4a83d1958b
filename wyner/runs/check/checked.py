"""What the check of a run, or of every loop of a fleet, found."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.run_folder import loops_below
from wyner.runs.check import Result, judge
from wyner.runs.check.evidence import read_evidence
from wyner.runs.seal import READ, SEAL_ALONE, is_sealed


@dataclass(frozen=True)
class CheckedRun:
    """A run, and how it did by each rule.

    Parameters
    ----------
    run_dir : Path
    results : list of Result
    sealed : bool
        Whether `wyner up` ended the run and sealed its files.
    """

    run_dir: Path
    results: list[Result]
    sealed: bool

    @property
    def passed(self) -> bool:
        """Whether no rule failed."""
        return not self._count("FAIL")

    @property
    def counts(self) -> str:
        """How many rules passed, failed and were skipped."""
        return ", ".join(f"{self._count(kind)} {kind}" for kind in ("PASS", "FAIL", "SKIP"))

    def _count(self, kind: str) -> int:
        return sum(result.result == kind for result in self.results)

    def to_json(self) -> dict[str, Any]:
        """Every rule with its result, and which files are evidence."""
        return {
            "run_dir": str(self.run_dir),
            "passed": self.passed,
            "failed": self._count("FAIL"),
            "skipped": self._count("SKIP"),
            "sealed": self.sealed,
            "rules": [result.as_json() for result in self.results],
            "files": [*READ, *SEAL_ALONE],
        }

    def __str__(self) -> str:
        """A line for each rule, and how many there are of each result."""
        return "\n".join([*map(str, self.results), self.counts])


@dataclass(frozen=True)
class CheckedFleet:
    """The runs of a fleet's loops.

    Parameters
    ----------
    run_dir : Path
    loops : list of CheckedRun
    """

    run_dir: Path
    loops: list[CheckedRun]

    @property
    def passed(self) -> bool:
        """Whether no rule failed in any loop."""
        return all(loop.passed for loop in self.loops)

    def to_json(self) -> dict[str, Any]:
        """Every loop."""
        loops = [loop.to_json() for loop in self.loops]
        return {"run_dir": str(self.run_dir), "passed": self.passed, "loops": loops}

    def __str__(self) -> str:
        """A line for each loop, and below it the rules that it broke."""
        lines = []
        for loop in self.loops:
            lines.append(f"{loop.run_dir.name}: {loop.counts}")
            broken = [str(result) for result in loop.results if result.result == "FAIL"]
            lines += [f"  {line}" for text in broken for line in text.splitlines()]
        well = sum(loop.passed for loop in self.loops)
        return "\n".join([*lines, f"{well} of {len(self.loops)} loops PASS"])


def check_run(run_dir: Path) -> CheckedRun | CheckedFleet:
    """Judge a run that has ended by every rule, or each loop below a fleet's folder.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError, UsageError
        When there is no run, it cannot be read, or it goes on.
    """
    loops = loops_below(run_dir)
    if loops:
        return CheckedFleet(run_dir, [_checked(folder) for folder in loops])
    return _checked(run_dir)


def _checked(folder: Path) -> CheckedRun:
    e = read_evidence(folder)
    return CheckedRun(folder, judge(e), is_sealed(e.run.manifest))
