"""``wyner score``: what each eavesdropper got, beside what the paper's rule counts."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.statistics import COUNTED

if TYPE_CHECKING:
    from wyner.runs.run import Run
    from wyner.runs.score.keys import KeyAudit
    from wyner.runs.score.report import Report
    from wyner.runs.score.score import RunScore


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Score the eavesdroppers of one or more runs against the plant's traces. Exit 1 when one "
        "of them failed: nobody knows what it would have had. Of a capture "
        "alone, show what each makes of it."
    )
    parser.add_argument(
        "runs", metavar="RUN", nargs="+", help="a run's folder, or one of several; or a capture"
    )
    parser.add_argument(
        "--eavesdropper",
        action="append",
        default=[],
        metavar="NAME[,NAME...]",
        help="these on the captures, in place of what was said live: names, or "
        "path/to/file.py:Name",
    )
    parser.add_argument(
        "--scenario", metavar="S", help="tell the replayed ones this scenario's model"
    )
    parser.add_argument("--plot", metavar="F", help="draw the report, as F.png, F.pdf or F.svg")
    parser.add_argument("--json", action="store_true", help="one object on standard output")


def run(args: argparse.Namespace) -> int:
    """Score, pool and print."""
    from runtime.errors import UsageError, reading
    from wyner.cli.decode import decode

    with reading(", ".join(args.runs)):
        if any(Path(one).is_file() for one in args.runs):
            if len(args.runs) > 1:
                raise UsageError(f"RUN: got {len(args.runs)} of them, expected a capture alone")
            return decode(args, Path(args.runs[0]))
        return _run(args)


def _run(args: argparse.Namespace) -> int:
    import json
    import sys
    from collections import Counter

    from runtime.errors import DONE, FAILED, UsageError
    from runtime.run_folder import loops_below
    from tap_service.command import names_of
    from wyner.cli.drawing import drawn_to
    from wyner.runs.run import Run, RunError
    from wyner.runs.score import report as reporting
    from wyner.runs.score.counts import cost_of
    from wyner.runs.score.score import score_run

    names = names_of(args.eavesdropper)
    if args.scenario is not None and not names:
        raise UsageError(
            "--scenario: tells replayed eavesdroppers a model, expected --eavesdropper"
        )
    scores: list[RunScore] = []
    given = [Path(text) for text in args.runs]
    run_dirs = [one for folder in given for one in loops_below(folder) or [folder]]
    for folder, times in Counter(path.resolve() for path in run_dirs).items():
        if times > 1:
            raise UsageError(f"RUN: {folder}: given {times} times, expected each run once")
    runs = []
    for run_dir in run_dirs:
        try:
            run = Run.load(run_dir)
            if not run.has("plant"):
                raise UsageError(f"{run_dir}: no run here, expected a run's folder")
            if names:
                scores.append(_replayed(run, names, args.scenario))
            else:
                scores.append(score_run(run))
        except RunError as error:
            raise UsageError(str(error)) from None
        if gone := run.parts_missing("plant"):
            what = f"parts 0 to {gone - 1} of the plant's trace are gone"
            print(f"wyner: {run_dir}: {what}: only what came after is scored", file=sys.stderr)
        if not run.ended("plant"):
            what = "the plant's trace has no end: it runs still, was killed, or the file was cut"
            print(f"wyner: {run_dir}: {what}; what is there is scored", file=sys.stderr)
        runs.append(run)
    report = reporting.report(scores)
    if args.plot is not None:
        drawn_to("--plot", args.plot, (7.0, 3.6), lambda figure: _draw(figure, report))
    audits = _audits(runs)
    ending = FAILED if any(tap.failed for score in scores for tap in score.taps) else DONE
    if args.json:
        keys = {name: audit.as_json(blocks=True) for name, audit in audits.items()}
        costs = {str(run.folder): cost_of(run) for run in runs}
        said = {**report.to_json(), "keys": keys, "control_cost": costs}
        said["no_interval"] = {"control_cost": COUNTED}
        print(json.dumps(said))
        return ending
    _print(report, color=sys.stdout.isatty())
    for run in runs:
        cost = cost_of(run)
        if cost is not None:
            print(f"control cost of {run.folder}: {cost:.4g} a step, x' Q x + u' R u")
    for name, audit in audits.items():
        _print_keys(name, audit, color=sys.stdout.isatty())
    return ending


def _draw(figure: Any, report: "Report") -> str:
    from wyner.drawing.secrecy import draw_report

    axes = figure.subplots()
    draw_report(axes, report)
    axes.set_title(report.verdict(), fontsize=9, loc="left")
    return ""


def _audits(runs: "list[Run]") -> "dict[str, KeyAudit]":
    """What the tap of each run that makes keys holds of them."""
    from protocol.scenario import ScenarioError
    from wyner.runs.score.keys import audit_keys

    audits = {}
    for one in runs:
        try:
            audit = audit_keys(one, one.scenario)
        except ScenarioError:
            continue
        if audit is not None:
            audits[one.name] = audit
    return audits


def _print_keys(name: str, audit: "KeyAudit", *, color: bool) -> None:
    """A row for each key block, and what must be told in red."""
    from os import environ

    from wyner.runs.score.keys import key_lines

    print(f"\nkey blocks of {name}")
    if audit.blocks:
        print("block  transitions  lost  rows  keys  Eve missed  Eve holds, bit")
    for block in audit.blocks:
        print(
            f"{block.number:5}  {block.transitions:11}  {block.lost:4}  {block.rows:4}  "
            f"{block.keys:4}  {_known(block.missed):>10}  "
            f"{_known(block.held_bits if block.keys else 0):>14}"
        )
    for line in key_lines(audit.as_json()):
        red = color and "WARNING" in line and "NO_COLOR" not in environ
        print(f"\x1b[31m{line}\x1b[0m" if red else line)


def _known(count: int | None) -> str:
    return "-" if count is None else str(count)


def _replayed(run: "Run", names: tuple[str, ...], scenario_name: str | None) -> "RunScore":
    from runtime.errors import UsageError
    from runtime.scenario_file import scenario_of
    from tap_service.capture.reading import CaptureError
    from tap_service.eavesdroppers import KnowledgeError
    from wyner.runs.score.replay import Replay
    from wyner.runs.score.score import RunScore, read_truth, score

    truth = read_truth(run)
    scenario = None if scenario_name is None else scenario_of(scenario_name)
    try:
        replay = Replay(run.folder, names, scenario=scenario)
        replay.run()
    except CaptureError as error:
        raise UsageError(str(error)) from None
    except KnowledgeError as error:
        raise UsageError(f"--eavesdropper: {error}") from None
    return RunScore(run.name, truth, tuple(score(truth, said) for said in replay.outputs()))


def _print(report: object, *, color: bool) -> None:
    from os import environ

    from protocol.text import printable
    from wyner.runs.score.report import BOUND, HEADINGS, NOTE, Report, held_line, remarks, rows

    assert isinstance(report, Report)
    table = [HEADINGS, *rows(report)]
    widths = [max(len(row[i]) for row in table) for i in range(len(HEADINGS))]
    for row in table:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )
    for tap in report.taps:
        for remark in remarks(tap):
            print(printable(f"{tap.name}: {remark}"))
        for held in tap.keys:
            print(printable(f"{tap.name}: {held_line(held)}"))
    print()
    print(
        f"{len(report.runs)} run{'' if len(report.runs) == 1 else 's'}, "
        f"{report.transitions} transitions; by the paper's rule "
        f"{report.claimed_bits:.0f} bits count as secret"
    )
    print(NOTE)
    red = color and report.exceeds and "NO_COLOR" not in environ
    verdict = report.verdict()
    print(f"\x1b[31m{verdict}\x1b[0m" if red else verdict)
    print(BOUND)
