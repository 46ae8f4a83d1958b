"""``wyner report``: a run on one page of HTML, or as data for other tools."""

import argparse
import sys
from pathlib import Path

from runtime.errors import DONE, Failure, UsageError, needs, reading, writing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write one self-contained HTML page of a run: what counts as secret by the paper's rule "
        "against the truth, what was sent and recovered, states and inputs, keys against "
        "taps over time, and the checks. Or write what the tap captured in a format that other "
        "tools open: the ending of --output says which. The file's path goes to standard output."
    )
    parser.add_argument(
        "run_dir", type=Path, metavar="RUN", help="the run's folder; or a capture, to export it"
    )
    parser.add_argument(
        "--output",
        "-o",
        type=Path,
        metavar="FILE",
        help="F.html, a page (default: RUN/report.html); F.csv, F.parquet or F.mcap, the capture, "
        "a row or record a message",
    )
    parser.add_argument(
        "--steps",
        action="store_true",
        help="one row a step, one column a number (CSV, Parquet), instead of a row a message; of a "
        "run with what the plant knows beside it (coin, key, gauges)",
    )


def run(args: argparse.Namespace) -> int:
    """Write the page, or the capture."""
    from wyner.runs.export import KINDS

    kind = ".html" if args.output is None else args.output.suffix
    if kind not in (".html", *KINDS):
        expected = f"expected a name that ends in .html, {', '.join(KINDS)}"
        raise UsageError(f"--output: got {str(args.output)!r}, {expected}")
    if args.steps and kind not in (".csv", ".parquet"):
        raise UsageError("--steps: expected --output FILE.csv or FILE.parquet")
    print(_page(args) if kind == ".html" else _exported(args))
    return DONE


def _page(args: argparse.Namespace) -> Path:
    from runtime.recording import TraceError
    from wyner.runs.run import RunError

    try:
        from wyner.runs.page import write_report
    except ImportError:
        raise Failure(needs("report", "matplotlib jinja2")) from None
    try:
        with reading(str(args.run_dir)):
            return write_report(args.run_dir, args.output)
    except FileNotFoundError as error:
        raise UsageError(str(error)) from None
    except OSError as error:
        where = error.filename or args.run_dir
        raise UsageError(f"{where}: {error.strerror or error}") from None
    except (TraceError, RunError) as error:
        raise UsageError(str(error)) from None


def _exported(args: argparse.Namespace) -> Path:
    from tap_service.capture.export import ExportError
    from tap_service.capture.reading import CaptureError
    from wyner.runs.export import export_messages, export_steps
    from wyner.runs.run import RunError

    export = export_steps if args.steps else export_messages
    output: Path = args.output
    try:
        with writing(f"--output: {output}"):
            print(f"wyner: {export(args.run_dir, output)}", file=sys.stderr)
    except (CaptureError, RunError) as error:
        raise UsageError(str(error)) from None
    except ExportError as error:
        raise Failure(str(error)) from None
    except ImportError:
        raise Failure(needs("parquet", "pyarrow")) from None
    return output
