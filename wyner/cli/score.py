"""``wyner score``: what each eavesdropper got, beside what the paper's rule counts."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.errors import DONE, FAILED, UsageError, reading
from wyner.cli.drawing import add_plot, drawable, plot
from wyner.cli.results import add_json, show

if TYPE_CHECKING:
    from wyner.runs.score.replay import Decoded
    from wyner.runs.score.scored import ScoredRuns


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Compare the guesses of the eavesdroppers of one or more runs with the plant's traces. "
        "Exit code 1 when one of them failed. Of a capture alone, for which there is no plant's "
        "trace, print what each eavesdropper reads."
    )
    parser.add_argument(
        "runs", metavar="RUN", nargs="+", help="a run's folder, or one of several; or a capture"
    )
    parser.add_argument(
        "--eavesdropper",
        action="append",
        default=[],
        metavar="NAME[,NAME...]",
        help="run these on the recorded captures, in place of those that ran live: names, or "
        "path/to/file.py:Name",
    )
    add_plot(parser, "score.png here")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Score and print."""
    from tap_service.capture.reading import CaptureError
    from tap_service.command import names_of
    from tap_service.eavesdroppers import KnowledgeError
    from wyner.runs.run import RunError

    paths, names = [Path(text) for text in args.runs], names_of(args.eavesdropper)
    if args.plot is not None:
        drawable(args.plot or "score.png")
    found: Decoded | ScoredRuns
    scored: ScoredRuns | None = None
    try:
        with reading(", ".join(args.runs)):
            if any(path.is_file() for path in paths):
                if args.plot is not None:
                    raise UsageError("--plot: expected runs; of a capture the truth is not known")
                found = _decode(paths, names)
            else:
                from wyner.runs.score.scored import score_runs

                scored = found = score_runs(paths, names)
    except (CaptureError, RunError) as error:
        raise UsageError(str(error)) from None
    except KnowledgeError as error:
        raise UsageError(f"--eavesdropper: {error}") from None
    for note in found.notes:
        print(f"wyner: {note}", file=sys.stderr)
    show(found, args)
    if args.plot is not None and scored is not None:
        from wyner.drawing.secrecy import draw_scored

        report = scored.report
        name = args.plot or "score.png"
        plot(name, (7.0, 3.6), lambda f: draw_scored(f, report), silent=args.json)
    return FAILED if found.failed else DONE


def _decode(paths: Sequence[Path], names: tuple[str, ...]) -> "Decoded":
    """A capture alone."""
    from tap_service.capture.reading import CaptureReader
    from tap_service.eavesdroppers import DEFAULT
    from wyner.runs.score.replay import hear_again

    if len(paths) > 1:
        raise UsageError(f"RUN: got {len(paths)} of them, expected a capture alone")
    live = CaptureReader(paths[0]).header.get("eavesdroppers")
    return hear_again(paths[0], names or tuple(live or DEFAULT))
