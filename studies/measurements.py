"""How each data file of docs/data is made, and by which code."""

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from runtime.files import PUBLIC_FILE, replacing
from studies import (
    corners,
    keys,
    loops,
    missed_steps,
    network,
    noise,
    other_sets,
    outputs,
    readings,
    settled,
    shape,
    signalling,
    waiting,
)
from studies.attacks import study as attacks
from studies.attacks import watermark
from studies.secrecy import reading, study
from wyner.sweeps import SWEEPS
from wyner.sweeps.code import code_version, loop_version, same_code
from wyner.sweeps.grid import load_sweep, points_of
from wyner.sweeps.results import Results
from wyner.sweeps.running import SerialExecutor, run_sweep

Rows = Callable[[], Iterable[Sequence[Any]]]


class Measurement(NamedTuple):
    """How a data file is made, and the version of the code that would make it today."""

    measure: Callable[[Path], None]
    version: Callable[[], str]


def write(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]], version: str) -> None:
    """Write a CSV file with a column ``version``; it replaces the one before when it is whole."""
    with (
        replacing(path, PUBLIC_FILE) as partial,
        partial.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("version", *columns))
        writer.writerows((version, *row) for row in rows)


def of_sweep(name: str) -> Measurement:
    """The measurement of a shipped sweep."""

    def measure(path: Path) -> None:
        file = SWEEPS / f"{name}.toml"
        sweep = load_sweep(file)
        with replacing(path, PUBLIC_FILE) as partial:
            partial.unlink()  # a sweep makes its file itself
            results = Results(partial, sweep.columns, resume=False)
            try:
                points = points_of(sweep, file.parent)
                failures = run_sweep(sweep, points, results, SerialExecutor())
            finally:
                results.close()
            if failures:
                raise RuntimeError("; ".join(failures))

    return Measurement(measure, loop_version)


def of_rows(columns: Sequence[str], rows: Rows) -> Measurement:
    """The measurement of a study: its rows come from the module of ``rows``."""

    def version() -> str:
        return code_version(rows.__module__)

    return Measurement(lambda path: write(path, columns, rows(), version()), version)


FIGURE_SWEEPS: Final = (
    "fig7-paper-20",
    "fig7-paper",
    "fig7-sustained",
    "sustained-long",
    "disturbances",
    "price",
)

MEASUREMENTS: Final[dict[str, Measurement]] = {
    **{name: of_sweep(name) for name in FIGURE_SWEEPS},
    "distance": of_rows(loops.DISTANCE_COLUMNS, loops.distance_rows),
    "taps": of_rows(loops.TAP_COLUMNS, loops.tap_rows),
    "widths": of_rows(loops.WIDTH_COLUMNS, loops.width_rows),
    "sets": of_rows(loops.SET_COLUMNS, loops.set_rows),
    "settled": of_rows(settled.COLUMNS, settled.settled_rows),
    **{
        f"secrecy-{name}": Measurement(study.measure_study(name), study.version)
        for name in study.STUDIES
    },
    "secrecy-reading": Measurement(reading.add_rows, reading.version),
    "signalling-rates": of_rows(signalling.RATE_COLUMNS, signalling.rate_rows),
    "signalling-price": of_rows(signalling.PRICE_COLUMNS, signalling.price_rows),
    "two-step": of_rows(signalling.CODE_COLUMNS, signalling.code_rows),
    "block-codes": of_rows(signalling.BLOCK_COLUMNS, signalling.block_rows),
    "noise-bound": of_rows(noise.COLUMNS, noise.bound_rows),
    "secrecy-shape": of_rows(shape.COLUMNS, shape.shape_rows),
    "missed-steps": of_rows(missed_steps.COLUMNS, missed_steps.missed_rows),
    "other-sets": of_rows(other_sets.COLUMNS, other_sets.other_set_rows),
    "readings": of_rows(readings.COLUMNS, readings.reading_rows),
    "corners": of_rows(corners.COLUMNS, corners.corner_rows),
    "outputs": of_rows(outputs.COLUMNS, outputs.output_rows),
    "waiting": of_rows(waiting.COLUMNS, waiting.waiting_rows),
    "network": of_rows(network.COLUMNS, network.network_rows),
    "key-controls": of_rows(keys.CONTROL_COLUMNS, keys.control_rows),
    "attacks": Measurement(attacks.add_rows, attacks.version),
    "dither-price": of_rows(watermark.COLUMNS, watermark.price_rows),
}
"""How each data file of docs/data is made."""


def stale(folder: Path) -> Iterator[str]:
    """A line for each file with rows that other code than today's made."""
    for name, measurement in MEASUREMENTS.items():
        with (folder / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            versions = [row["version"] for row in csv.DictReader(file)]
        now = measurement.version()
        other = Counter(version for version in versions if not same_code(version, now))
        if other:
            by = ", ".join(f"{version} ({count})" for version, count in other.most_common())
            yield f"{name}.csv: {other.total()} of {len(versions)} rows by {by}; today {now}"
