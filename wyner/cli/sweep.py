"""``wyner sweep``: run a grid of experiments."""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.statistics import STATED
from runtime.errors import DONE, FAILED, INTERRUPTED, Failure, UsageError, writing
from runtime.progress import shown
from wyner.cli.drawing import add_options, draw_sweep, drawable
from wyner.sweeps import SWEEPS

if TYPE_CHECKING:
    from wyner.sweeps.results import Summary


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
    parser.add_argument("--quick", action="store_true", help="few runs of each point, to look")
    parser.add_argument("--output", metavar="CSV", help="default: runs/sweeps/NAME.csv")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the sweep, draw its rows, or both."""
    if Path(args.file).suffix == ".csv":
        if args.plot is None:
            raise UsageError(f"FILE: got rows, {args.file!r}, expected --plot with them")
        print(draw_sweep(Path(args.file), args))
        return DONE
    from runtime.options import at_least
    from tap_service.command import find_each
    from tap_service.eavesdroppers import named
    from wyner.sweeps.grid import SweepError, eavesdroppers_of, load_sweep, points_of
    from wyner.sweeps.results import Results, key_of, ready_rows, summarise, write_ready
    from wyner.sweeps.running import name_of, run_sweep
    from wyner.sweeps.workers import workers

    jobs = os.cpu_count() or 1 if args.jobs is None else args.jobs
    at_least("--jobs", jobs, 1)
    if args.plot is not None:
        drawable("--plot", args.plot or "rows.png")
    shipped = SWEEPS / f"{args.file}.toml"
    path = shipped if not Path(args.file).is_file() and shipped.is_file() else Path(args.file)
    try:
        sweep = load_sweep(path)
        if args.quick:
            sweep = sweep.quickly()
        sweep = sweep.model_copy(
            update={"eavesdroppers": tuple(eavesdroppers_of(sweep, path.parent))}
        )
        find_each(sweep.eavesdroppers, named, f"{path}: eavesdroppers: ")
        points = points_of(sweep, path.parent)
        name = sweep.name + ("-quick" if args.quick else "")
        output = Path(args.output or f"runs/sweeps/{name}.csv")
        taps = [name_of(e) for e in sweep.eavesdroppers]
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
    grid, new = list(sweep.columns), len(results.rows) - before
    stopped = sweep.stop is not None
    ready = output.with_name(f"{output.stem}-rates.csv")
    if summaries:
        write_ready(ready, ready_rows(summaries, grid, stopped=stopped))
    if args.json:
        print(json.dumps(_as_object(sweep.name, output, grid, new, summaries, stopped=stopped)))
    else:
        print(_render(grid, summaries, stopped=stopped))
        print(f"{len(results.rows)} rows in {output}, {new} of them new")
        print(
            f"rates and intervals, a row a point, in {ready}; "
            f"`wyner sweep {ready} --plot` draws them"
        )
    for line in failures:
        print(f"wyner: {line}", file=sys.stderr)
    if args.plot is not None and results.rows:
        print(draw_sweep(output, args), file=sys.stderr if args.json else sys.stdout)
    return FAILED if failures else DONE


def _as_object(
    name: str,
    output: Path,
    grid: list[str],
    new: int,
    summaries: "list[Summary]",
    *,
    stopped: bool,
) -> dict[str, Any]:
    points = []
    for s in summaries:
        rate = (s.rate_at_every_look if stopped else s.rate).as_json()
        fixed = {k: v for k, v in s.first.items() if k in ("task", "scenario", "variant")}
        fields = {field: json.loads(s.first[field]) for field in grid}
        points.append(
            {
                **fixed,
                "fields": fields,
                "runs": s.runs,
                "bits_per_second": rate["value"],
                "interval_95": [rate["low"], rate["high"]],
                **({"no_interval": rate["no_interval"]} if "no_interval" in rate else {}),
                "secret": {
                    "bits_per_second_at_most": s.secret,
                    "no_interval": {"bits_per_second_at_most": STATED},
                },
                "costs": {name: cost.as_json() for name, cost in s.costs.items()},
                "shares": {name: share.as_json() for name, share in s.shares.items()},
                **s.counts,
            }
        )
    return {"sweep": name, "output": str(output), "new_rows": new, "points": points}


def _share(s: "Summary", name: str) -> str:
    counts = s.taps[name]
    keys = s.shares[f"{name} keys known"].scaled(100.0)
    return f"{keys.text('.1f', ' %')}, {counts['read']} of {counts['delivered']}"


def _render(grid: list[str], summaries: "list[Summary]", *, stopped: bool) -> str:
    """A table: the fields of each point, its runs, its rate with the interval."""
    taps = list(summaries[0].taps) if summaries else []
    interval = "95 % at every look" if stopped else "95 % interval"
    head = ["scenario", "variant", *grid, "runs", "bit/s", interval, "secret at most"]
    head += ["x'x", "u'u", "mistaken"]
    head += [f"{name} keys, messages" for name in taps]
    rows = [head]
    for s in summaries:
        rate = s.rate_at_every_look if stopped else s.rate
        rows.append(
            [
                str(s.first["scenario"]),
                str(s.first["variant"]),
                *(str(s.first[name]) for name in grid),
                str(s.runs),
                f"{rate.value:.4g}",
                f"[{rate.low:.4g}, {rate.high:.4g}]" if rate.known else "none",
                "no eavesdropper" if s.secret is None else f"{s.secret:.2g}",
                *(f"{cost.value:.3g}" for cost in s.costs.values()),
                str(s.counts["mistaken"]),
                *(_share(s, name) for name in taps),
            ]
        )
    keep = [i for i in range(len(head)) if any(row[i] for row in rows[1:])] or [0]
    widths = [max(len(row[i]) for row in rows) for i in keep]
    return "\n".join(
        "  ".join(row[i].ljust(w) for i, w in zip(keep, widths, strict=True)).rstrip()
        for row in rows
    )
