"""``wyner export``: write a capture as MCAP, CSV or Parquet."""

import argparse
from collections.abc import Iterator
from typing import Any


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Write a capture in a format that other tools open. CSV goes to standard "
        "output unless a file is named."
    )
    parser.add_argument("capture", metavar="CAPTURE", help="a capture, or a run's directory")
    parser.add_argument("--to", required=True, choices=("mcap", "csv", "parquet"))
    parser.add_argument(
        "--steps",
        action="store_true",
        help="one row a step, one column a number (CSV, Parquet), instead of a row a message",
    )
    parser.add_argument(
        "--truth",
        action="store_true",
        help="with --steps of a run: what the plant knows beside it (coin, key, gauges)",
    )
    parser.add_argument(
        "--leakage",
        action="store_true",
        help="of a run: one row an agreed step, the key symbol (secret) and x(k+1) less each "
        "prediction (view), for estimators such as F-BLEAU",
    )
    parser.add_argument("--output", metavar="FILE", help="default: capture.mcap or .parquet here")


def run(args: argparse.Namespace) -> int:
    """Write the file and say how many messages it holds."""
    import sys
    from pathlib import Path

    from runtime.errors import DONE, Failure, UsageError
    from runtime.files import PUBLIC_FILE, replacing
    from tap_service.capture.export import BINARY, ExportError, is_part, to_csv
    from tap_service.capture.reading import CaptureError, CaptureReader

    if args.leakage and (args.steps or args.truth):
        raise UsageError("--leakage: expected neither --steps nor --truth")
    if args.steps or args.truth or args.leakage:
        return _steps(args)
    output = args.output or (None if args.to == "csv" else f"capture.{args.to}")
    try:
        reader = CaptureReader(Path(args.capture))
        if output is None:
            count = to_csv(reader, sys.stdout)
        elif is_part(reader, Path(output)):
            raise UsageError(f"--output: {output}: is a part of the capture itself")
        else:
            with replacing(Path(output), PUBLIC_FILE) as path:
                if args.to == "csv":
                    with path.open("w", encoding="utf-8", newline="") as file:
                        count = to_csv(reader, file)
                else:
                    count = BINARY[args.to](reader, path)
    except CaptureError as error:
        raise UsageError(str(error)) from None
    except ExportError as error:
        raise Failure(str(error)) from None
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        raise Failure(f"{output or args.to}: cannot be written: {error.strerror}") from None
    reader.finish()
    print(
        f"{count} messages, {reader.malformed} undecodable left out, {reader.torn} torn lines",
        file=sys.stderr,
    )
    return DONE


def _steps(args: argparse.Namespace) -> int:
    """One row a step, or an agreed step, to a file or to standard output."""
    import sys
    from pathlib import Path

    from runtime.errors import DONE, Failure, UsageError, needs
    from runtime.files import PUBLIC_FILE, replacing
    from tap_service.capture.reading import CaptureError, CaptureReader
    from wyner.runs.run import Run, RunError
    from wyner.runs.score.leakage import LeakedKey, leakage_line, leakage_rows, leaked_keys
    from wyner.runs.score.step_table import step_rows, truth_of, write_csv, write_parquet

    if args.truth and not args.steps:
        raise UsageError("--truth: expected together with --steps")
    kind = "leakage" if args.leakage else "steps"
    if args.to == "mcap":
        raise UsageError(f"--{kind}: expected --to csv or --to parquet")
    output = args.output or (None if args.to == "csv" else f"{kind}.parquet")
    try:
        views: list[LeakedKey] = []
        truth = truth_of(Run.load(args.capture)) if args.truth or args.leakage else None
        if truth is not None and args.leakage:
            views = leaked_keys(CaptureReader(Path(args.capture)), truth)

        def rows() -> Iterator[dict[str, Any]]:
            if args.leakage:
                return leakage_rows(views)
            return step_rows(CaptureReader(Path(args.capture)), truth)

        if output is None:
            count = write_csv(rows, sys.stdout)
        else:
            with replacing(Path(output), PUBLIC_FILE) as path:
                if args.to == "csv":
                    with path.open("w", encoding="utf-8", newline="") as file:
                        count = write_csv(rows, file)
                else:
                    count = write_parquet(rows, path)
    except (CaptureError, RunError) as error:
        raise UsageError(str(error)) from None
    except ImportError:
        raise Failure(needs("parquet", "pyarrow")) from None
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        raise Failure(f"{output or args.to}: cannot be written: {error.strerror}") from None
    print(f"{count} {'agreed steps' if args.leakage else 'steps'}", file=sys.stderr)
    if args.leakage:
        print(leakage_line(views), file=sys.stderr)
    return DONE
