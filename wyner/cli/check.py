"""``wyner check``: say, one rule after another, whether a run obeyed it."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final

from protocol.text import printable
from runtime.errors import DONE, FAILED, UsageError

if TYPE_CHECKING:
    from wyner.runs.check import Result


WIDTH: Final = 78
"""Columns of the help, which has a table and is not set anew."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = fill(
        "Replay the traces and the capture of a run that has ended through the pure "
        "functions of the protocol, and say PASS or FAIL for each rule. A rule "
        "for which the run left nothing to look at is SKIP. Exit code 0 when none fails, 1 when "
        "one does, 2 when there is no run.",
        WIDTH,
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _table()
    parser.add_argument(
        "run_dir", type=Path, metavar="RUN_DIR", help="the run's folder, or a fleet's"
    )
    parser.add_argument("--json", action="store_true", help="print one object for machines")


def _table() -> str:
    """Which files are evidence, for people."""
    from wyner.runs.evidence_files import KINDS

    wide = max(len(kind.pattern) for kind in KINDS)
    lines = ["evidence, and what holds it (the seal: that of a run that wyner up has ended):"]
    lines += [f"  {kind.pattern:<{wide}}  {kind.held_by}" for kind in KINDS if kind.evidence]
    lines.append("no evidence:")
    lines += [f"  {kind.pattern:<{wide}}  {kind.held_by}" for kind in KINDS if not kind.evidence]
    return "\n".join([*lines, "  and whatever else lies in the folder"])


def run(args: argparse.Namespace) -> int:
    """Read, judge, print; of a fleet every loop."""
    from runtime.run_folder import loops_below

    loops = loops_below(args.run_dir)
    if not loops:
        results = results_of(args.run_dir)
        if args.json:
            print(json.dumps(summary_of(args.run_dir, results)))
        else:
            for result in results:
                print("\n".join(printable(line) for line in lines_of(result)))
            print(counted(results))
        return FAILED if any(f.result == "FAIL" for f in results) else DONE
    summaries: list[dict[str, Any]] = []
    for folder in loops:
        results = results_of(folder)
        summaries.append(summary_of(folder, results))
        if not args.json:
            print(f"{folder.name}: {counted(results)}")
            for result in results:
                if result.result == "FAIL":
                    print("\n".join(printable(f"  {line}") for line in lines_of(result)))
    failed = sum(not summary["passed"] for summary in summaries)
    if args.json:
        whole = {"run_dir": str(args.run_dir), "passed": not failed, "loops": summaries}
        print(json.dumps(whole))
    else:
        print(f"{len(loops) - failed} of {len(loops)} loops PASS")
    return FAILED if failed else DONE


def results_of(folder: Path) -> "list[Result]":
    """How a run did by each rule.

    Raises
    ------
    UsageError
        When there is no run that can be read, or it has not ended.
    """
    from protocol.scenario import ScenarioError
    from wyner.runs.check import judge
    from wyner.runs.check.evidence import read_evidence

    try:
        return judge(read_evidence(folder))
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    except OSError as error:
        raise UsageError(str(error)) from None


def summary_of(folder: Path, results: "Sequence[Result]") -> dict[str, Any]:
    """The results of a run, for machines."""
    from wyner.runs.evidence_files import KINDS
    from wyner.runs.run import Run
    from wyner.runs.seal import is_sealed

    failed = sum(f.result == "FAIL" for f in results)
    return {
        "run_dir": str(folder),
        "passed": not failed,
        "failed": failed,
        "skipped": sum(f.result == "SKIP" for f in results),
        "sealed": is_sealed(Run.load(folder).manifest),
        "rules": [f.as_json() for f in results],
        "files": [kind._asdict() for kind in KINDS],
    }


def counted(results: "Sequence[Result]") -> str:
    """How many results there are of each kind."""
    kinds = [r.result for r in results]
    return ", ".join(f"{kinds.count(r)} {r}" for r in ("PASS", "FAIL", "SKIP"))


def lines_of(result: "Result") -> list[str]:
    """A rule for people: one line, and one more for the first place where it is broken."""
    rule, findings = result.rule, result.findings
    note = f" [{result.note}]" if result.note else ""
    lines = [f"{result.result}  {rule.name:10} {rule.source:25} {rule.says}{note}"]
    if findings:
        many = f"{len(findings)} findings" if len(findings) > 1 else "1 finding"
        where = str(findings[0]).removeprefix(f"{rule.name}: ")
        lines.append(f"      {many}, first: {where}")
    return lines
