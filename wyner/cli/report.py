"""``wyner report``: a run on one page of HTML, or as data for other tools."""

import argparse
from pathlib import Path

from runtime.errors import DONE, Failure, UsageError, needs, reading


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write one self-contained HTML page of a run: what counts as secret by the paper's rule "
        "against the truth, what was sent and recovered, states and inputs, keys against "
        "taps over time, and the checks. The page's path goes to standard output. With --to, write "
        "what the tap captured in a format that other tools open."
    )
    parser.add_argument(
        "run_dir", type=Path, metavar="RUN", help="the run's folder; with --to, or a capture"
    )
    parser.add_argument(
        "--to",
        choices=("html", "csv", "parquet", "mcap"),
        default="html",
        help="a page (default), or the capture, a row or record a message",
    )
    parser.add_argument(
        "--steps",
        action="store_true",
        help="one row a step, one column a number (CSV, Parquet), instead of a row a message; of a "
        "run with what the plant knows beside it (coin, key, gauges)",
    )
    parser.add_argument(
        "--output",
        "-o",
        type=Path,
        metavar="FILE",
        help="default: RUN/report.html; CSV to standard output; capture.mcap or .parquet here",
    )


def run(args: argparse.Namespace) -> int:
    """Write the page, or the capture."""
    if args.to != "html":
        from wyner.cli.export import export

        return export(args.run_dir, args.to, args.output, steps=args.steps)
    if args.steps:
        raise UsageError("--steps: expected together with --to csv or --to parquet")
    from protocol.scenario import ScenarioError
    from runtime.recording import TraceError
    from wyner.runs.run import RunError

    try:
        from wyner.runs.page import write_report
    except ImportError:
        raise Failure(needs("report", "matplotlib jinja2")) from None
    try:
        with reading(str(args.run_dir)):
            page = write_report(args.run_dir, args.output)
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    except FileNotFoundError as error:
        raise UsageError(str(error)) from None
    except OSError as error:
        where = error.filename or args.run_dir
        raise UsageError(f"{where}: {error.strerror or error}") from None
    except (TraceError, RunError) as error:
        raise UsageError(str(error)) from None
    print(page)
    return DONE
