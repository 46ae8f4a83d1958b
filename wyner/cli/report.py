"""``wyner report``: a run on one page of HTML."""

import argparse
from pathlib import Path

from protocol.runtime.errors import DONE, UsageError, reading


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write one self-contained HTML page of a run: what was sent and recovered, "
        "states and inputs, one agreed step, keys against taps over time, the paper's claim "
        "against the truth, and the clauses of the check. The page's path goes to standard output."
    )
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR", help="the run's folder")
    parser.add_argument(
        "--output", "-o", type=Path, metavar="FILE", help="the page (default: RUN_DIR/report.html)"
    )


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from protocol.runtime.trace import TraceError
    from protocol.scenario import ScenarioError
    from wyner.run_report import write_report

    try:
        with reading(str(args.run_dir)):
            page = write_report(args.run_dir, args.output)
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    except (TraceError, OSError) as error:
        raise UsageError(str(error)) from None
    print(page)
    return DONE
