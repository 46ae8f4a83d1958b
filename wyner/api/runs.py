"""Runs of the services, from their folders."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wyner.runs.check.evidence import Finding


def check(run_dir: str | Path) -> "list[Finding]":
    """Where a run did not obey a rule, as ``wyner check`` finds it; empty where it obeyed all.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError, UsageError
        When there is no run, it cannot be read, or it goes on.
    """
    from wyner.runs.check import check as judge
    from wyner.runs.check.evidence import read_evidence

    return judge(read_evidence(Path(run_dir)))


def report(run_dir: str | Path, output: str | Path | None = None) -> Path:
    """Write the page of a run, by default as ``report.html`` in its folder; returns its path.

    Raises
    ------
    FileNotFoundError, ScenarioError, TraceError, UsageError
        When there is no run, it cannot be read, or it goes on.
    """
    from wyner.runs.page import write_report

    return write_report(Path(run_dir), None if output is None else Path(output))
