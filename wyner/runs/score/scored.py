"""What the eavesdroppers of some runs got, with the runs' keys and what control cost."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from protocol.scenario import ScenarioError
from protocol.statistics import COUNTED
from protocol.text import aligned
from runtime.errors import UsageError
from runtime.run_folder import loops_below
from tap_service.eavesdroppers import ORACLE
from wyner.printout import Printout
from wyner.runs.run import Run
from wyner.runs.score.counts import cost_of
from wyner.runs.score.keys import KeyAudit, audit_keys
from wyner.runs.score.replay import hear_again
from wyner.runs.score.report import Report, report
from wyner.runs.score.score import RunScore, read_truth, score, score_run
from wyner.runs.score.words import (
    GUESSES,
    NOTE,
    SECRECY,
    guess_rows,
    held_line,
    remarks,
    secrecy_rows,
)


@dataclass(frozen=True, eq=False)
class ScoredRuns(Printout):
    """The scores of some runs.

    Parameters
    ----------
    report : Report
    failed : bool
        Whether an eavesdropper failed, so that nobody knows what it would have had.
    notes : list of str
        Runs of which not all was there to be scored.
    """

    report: Report
    failed: bool
    notes: list[str]


def score_runs(folders: Sequence[Path], names: Sequence[str] = ()) -> ScoredRuns:
    """Score the eavesdroppers of runs against the plant's traces, and pool them.

    Parameters
    ----------
    folders : sequence of Path
        Each a run's, or one that holds runs.
    names : sequence of str
        Eavesdroppers that hear the captures again, in place of those that listened live.

    Raises
    ------
    UsageError
        When a folder is no run, or one is given twice.
    RunError, CaptureError, KnowledgeError
        When a run cannot be scored, its capture cannot be read, or there is no such eavesdropper.
    """
    run_dirs = [one for folder in folders for one in loops_below(folder) or [folder]]
    for folder, times in Counter(path.resolve() for path in run_dirs).items():
        if times > 1:
            raise UsageError(f"RUN: {folder}: given {times} times, expected each run once")
    runs, scores, notes = [], list[RunScore](), list[str]()
    for run_dir in run_dirs:
        run = Run.load(run_dir)
        if not run.has("plant"):
            raise UsageError(f"{run_dir}: no run here, expected a run's folder")
        scores.append(_heard_again(run, names) if names else score_run(run))
        runs.append(run)
        trace = run.columns("plant")
        if trace.gone:
            what = f"parts 0 to {trace.gone - 1} of the plant's trace are gone"
            notes.append(f"{run_dir}: {what}: only what came after is scored")
        if not trace.ended:
            what = "the plant's trace has no end: it runs still, was killed, or the file was cut"
            notes.append(f"{run_dir}: {what}; what is there is scored")
    failed = any(tap.failed for one in scores for tap in one.taps)
    costs, audits = {str(run.folder): cost_of(run) for run in runs}, _audits(runs)
    found = report(scores)
    figures = {
        **found.to_json(),
        "keys": {name: audit.as_json(blocks=True) for name, audit in audits.items()},
        "control_cost": costs,
        "no_interval": {"control_cost": COUNTED},
    }
    lines = _tables(found)
    for where, cost in costs.items():
        if cost is not None:
            lines.append(f"control cost of {where}: {cost:.4g} a step, x' Q x + u' R u")
    for name, audit in audits.items():
        lines += ["", f"key blocks of {name}", str(audit)]
    return ScoredRuns(figures, lines, found, failed, notes)


def _tables(found: Report) -> list[str]:
    """Tables with a row for each eavesdropper, what must stand beside them, and the verdict."""
    lines = aligned([GUESSES, *guess_rows(found.taps)])
    lines += ["", *aligned([SECRECY, *secrecy_rows(found.taps)]), ""]
    for tap in found.taps:
        told = [*remarks(tap), *map(held_line, tap.keys)]
        lines += [f"{tap.name}: {remark}" for remark in told]
    counted = f"{len(found.runs)} run{'' if len(found.runs) == 1 else 's'}"
    counted += f", {found.transitions} transitions; by the paper's rule "
    counted += f"{found.claimed_bits:.0f} bits count as secret"
    return [*lines, "", counted, NOTE, "", found.verdict()]


def _heard_again(run: Run, names: Sequence[str]) -> RunScore:
    """The score of a run whose capture these eavesdroppers hear now."""
    truth = read_truth(run)
    scenario = run.scenario if ORACLE in names else None
    heard = hear_again(run.folder, names, scenario)
    return RunScore(run.name, truth, tuple(score(truth, said) for said in heard.taps))


def _audits(runs: Sequence[Run]) -> dict[str, KeyAudit]:
    """What the tap of each run that makes keys holds of them."""
    audits = {}
    for run in runs:
        try:
            audit = audit_keys(run, run.scenario)
        except ScenarioError:
            continue
        if audit is not None:
            audits[run.name] = audit
    return audits
