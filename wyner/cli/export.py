"""``wyner export``: write a capture as MCAP, CSV or Parquet."""

import argparse


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the command."""
    parser = subparsers.add_parser(
        "export",
        help="write a capture as MCAP, CSV or Parquet",
        description="Write a capture in a format that other tools open. CSV goes to standard "
        "output unless a file is named.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="a capture, or a run's directory")
    parser.add_argument("--to", required=True, choices=("mcap", "csv", "parquet"))
    parser.add_argument("--output", metavar="FILE", help="default: capture.mcap or .parquet here")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the file and say how many messages it holds."""
    import sys
    from pathlib import Path

    from protocol.runtime.process import DONE, Failure, UsageError
    from protocol.runtime.run_folder import PUBLIC_FILE, replacing
    from tap_service.capture.export import BINARY, ExportError, is_part, to_csv
    from tap_service.capture.recording import CaptureError, CaptureReader

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
        f"{count} messages, {reader.garbage} undecodable left out, {reader.torn} torn lines",
        file=sys.stderr,
    )
    return DONE
