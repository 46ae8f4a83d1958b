"""``wyner sweep``: run a grid of experiments."""

import argparse
import os
import sys
from pathlib import Path

from runtime.errors import DONE, FAILED, INTERRUPTED, Failure, UsageError, writing
from runtime.progress import shown
from wyner.cli.drawing import add_options, drawable, plot_sweep
from wyner.cli.results import add_json, show
from wyner.sweeps import SWEEPS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Run the sweep in FILE (or a shipped one, by name) and add its rows to a CSV "
        "file. Ctrl-C keeps what there is; --resume goes on. With --plot, draw the rows; those of "
        "a CSV file, or of its -rates.csv, without running anything."
    )
    parser.add_argument(
        "file", metavar="FILE", help="a TOML file or a shipped name; or the rows, FILE.csv"
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes or Dask workers (default: one a core)"
    )
    parser.add_argument(
        "--dask",
        nargs="?",
        const="",
        metavar="ADDRESS",
        help="run on Dask workers: those of the scheduler at ADDRESS, or local ones",
    )
    parser.add_argument("--resume", action="store_true", help="go on with the rows that are there")
    parser.add_argument("--output", metavar="CSV", help="default: runs/sweeps/NAME.csv")
    add_json(parser)
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the sweep, draw its rows, or both."""
    if Path(args.file).suffix == ".csv":
        if args.plot is None:
            raise UsageError(f"FILE: got rows, {args.file!r}, expected --plot with them")
        plot_sweep(Path(args.file), args)
        return DONE
    from runtime.options import at_least
    from tap_service.command import find_each
    from tap_service.eavesdroppers import named
    from wyner.sweeps.found import found_by_sweep
    from wyner.sweeps.grid import SweepError, eavesdroppers_of, load_sweep, points_of
    from wyner.sweeps.results import Results, key_of, ready_rows, summarise, write_ready
    from wyner.sweeps.running import name_of, run_sweep
    from wyner.sweeps.workers import workers

    jobs = os.cpu_count() or 1 if args.jobs is None else args.jobs
    at_least("--jobs", jobs, 1)
    if args.plot is not None:
        drawable(args.plot or "rows.png")
    shipped = SWEEPS / f"{args.file}.toml"
    path = shipped if not Path(args.file).is_file() and shipped.is_file() else Path(args.file)
    try:
        sweep = load_sweep(path)
        sweep = sweep.model_copy(
            update={"eavesdroppers": tuple(eavesdroppers_of(sweep, path.parent))}
        )
        find_each(sweep.eavesdroppers, named, f"{path}: eavesdroppers: ")
        points = points_of(sweep, path.parent)
        output = Path(args.output or f"runs/sweeps/{sweep.name}.csv")
        taps = [name_of(e) for e in sweep.eavesdroppers]
        if args.plot is not None and output.exists() and not args.resume:
            raise UsageError(
                f"{output}: exists; `wyner sweep {output} --plot` draws it, --resume goes on"
            )
        with writing(f"--output: {output}"):
            results = Results(output, sweep.columns, args.resume, taps)
    except SweepError as error:
        raise UsageError(error.problems) from None
    before = len(results.rows)
    try:
        with (
            workers(jobs, args.dask) as executor,
            shown(f"{sweep.name}, runs") as progress,
        ):
            failures = run_sweep(sweep, points, results, executor, progress)
    except KeyboardInterrupt:
        print(
            f"wyner: stopped: {len(results.rows)} rows kept in {output}; --resume goes on",
            file=sys.stderr,
        )
        return INTERRUPTED
    except SweepError as error:
        raise Failure(str(error)) from None
    finally:
        results.close()
    ours = {p.key for p in points}
    summaries = summarise(row for row in results.rows if key_of(row) in ours)
    rates = output.with_name(f"{output.stem}-rates.csv")
    if summaries:
        write_ready(rates, ready_rows(summaries, sweep.columns))
    found = found_by_sweep(
        name=sweep.name,
        output=output,
        rates=rates,
        grid=sweep.columns,
        rows=len(results.rows),
        new=len(results.rows) - before,
        points=summaries,
    )
    show(found, args)
    for line in failures:
        print(f"wyner: {line}", file=sys.stderr)
    if args.plot is not None and results.rows:
        plot_sweep(output, args, silent=args.json)
    return FAILED if failures else DONE
