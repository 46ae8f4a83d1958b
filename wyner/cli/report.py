"""``wyner report``: a run on one page of HTML."""

import argparse
import json
from pathlib import Path

from runtime.errors import DONE, UsageError, reading


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write one self-contained HTML page of a run: what counts as secret by the paper's rule "
        "against the truth, what was sent and recovered, states and inputs, keys against "
        "taps over time, and the checks. The page's path goes to standard output."
    )
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR", help="the run's folder")
    parser.add_argument(
        "--output", "-o", type=Path, metavar="FILE", help="the page (default: RUN_DIR/report.html)"
    )
    parser.add_argument("--json", action="store_true", help="one object on standard output")


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from protocol.scenario import ScenarioError
    from runtime.recording import TraceError
    from wyner.runs.page import write_report
    from wyner.runs.run import RunError

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
    print(json.dumps({"run_dir": str(args.run_dir), "page": str(page)}) if args.json else page)
    return DONE
