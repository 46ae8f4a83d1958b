"""Data of the figures that no sweep gives: single transitions, taps, and sets in the plane."""

import csv
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL, Gauge, predict
from protocol.arrays import Array
from protocol.convex import Polytope, planar_vertices
from protocol.scenario import Scenario
from runtime.files import PUBLIC_FILE, replacing
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies import (
    corners,
    keys,
    missed_steps,
    network,
    noise,
    other_sets,
    outputs,
    readings,
    shape,
    signalling,
    waiting,
)
from studies.attacks import study as attacks
from studies.attacks import watermark
from studies.secrecy.study import STUDIES, measure_study
from wyner.simulate.engine import Runs, simulate_runs, transfer
from wyner.simulate.engine.taps import listen
from wyner.sweeps import SWEEPS
from wyner.sweeps.grid import Point, code_version, load_sweep, points_of
from wyner.sweeps.results import Results
from wyner.sweeps.running import SerialExecutor, run_sweep

SEED: Final = 7
ALPHAS: Final = (1.5, 3.0, 8.0)
INITIAL_STATES: Final = ((1.0, -0.5), (4.0, -2.0), (-12.0, 6.0))
PLANTS: Final = ("sustained", "double-integrator", "quadruple-tank", "batch-reactor")
BINS: Final = 40
MESSAGE: Final = b"We sail at dawn."
TAP_RUNS, TAP_STEPS = 20, 1500
SHOWN_SETS: Final = (0, 1, 2, 3, 4, 6, 8)
SOURCES: Final = ("studies/measurements.py",)
"""Where the numbers of this module come from, besides those of a sweep."""
TAP_SOURCES: Final = (
    *SOURCES,
    "protocol/knowledge.py",
    "protocol/messages/*.py",
    "tap_service/inference/kept.py",
    "tap_service/inference/list_decoding.py",
    "tap_service/inference/hypotheses.py",
    "tap_service/inference/frame_scores.py",
    "tap_service/inference/opening.py",
    "tap_service/inference/output_model.py",
    "tap_service/inference/symbol_paths.py",
    "tap_service/inference/language_model.py",
    "tap_service/capture/transcript.py",
    "tap_service/eavesdroppers/__init__.py",
    "tap_service/eavesdroppers/base.py",
    "tap_service/eavesdroppers/list_decoder.py",
    "tap_service/eavesdroppers/nearest_centre.py",
)


@cache
def system(name: str) -> tuple[Scenario, CandidateLaw]:
    """A shipped scenario with its law."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    return scenario, make_law(scenario, cached_design(scenario))


def starting_at(scenario: Scenario, x: Sequence[float]) -> Scenario:
    """The scenario from another initial state."""
    plant = scenario.plant.model_copy(update={"initial_state": tuple(x)})
    return scenario.model_copy(update={"plant": plant})


def closed_form(delta: Array, D: Sequence[float], D_c: Sequence[float], alpha: float) -> Array:
    """Probability that x(k+1) is in Diff, two candidates, boxes D within D_c, d uniform in D.

    The true candidate's gauge is at most 1, so that x(k+1) is in Diff when the other's, the largest
    abs(d_i + delta_i) / w_i, is above 1 and at most alpha: two boxes' overlaps with D, subtracted.

    Parameters
    ----------
    delta : array, shape (..., n)
        c_0 - c_1, the distance of the two centres.
    D, D_c : sequence of float, shape (n,)
        Half-widths.
    alpha : float

    Returns
    -------
    array, shape (...)
    """

    def inside(scale: float) -> Array:
        share = np.ones(delta.shape[:-1])
        for i, (w, c) in enumerate(zip(D, D_c, strict=True)):
            low = np.maximum(-w, -scale * c - delta[..., i])
            high = np.minimum(w, scale * c - delta[..., i])
            share = share * np.maximum(0.0, high - low) / (2 * w)
        return share

    out: Array = inside(alpha) - inside(1.0)
    return out


def centre_distances(runs: Runs) -> Array:
    """c_0 - c_1 of every transition, shape (steps, R, n)."""
    assert runs.candidates is not None
    B = np.array(runs.scenario.B)
    du = (runs.candidates[:, 0] - runs.candidates[:, 1]).transpose(0, 2, 1)
    out: Array = du @ B.T
    return out


def gauges_of(scenario: Scenario, v: Array) -> Array:
    """g of each row of v, shape (..., n): in units of D_c."""
    H, h = (np.array(a) for a in scenario.defender.disturbance.rows())
    out: Array = np.maximum(0.0, (v @ H.T / h).max(axis=-1))
    return out


def write(
    path: Path,
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    sources: Sequence[str] = SOURCES,
) -> None:
    """Write a CSV file with a column ``version``; it replaces the one before when it is whole."""
    with (
        replacing(path, PUBLIC_FILE) as partial,
        partial.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("version", *columns))
        writer.writerows((code_version(*sources), *row) for row in rows)


def measure_distance(path: Path) -> None:
    """Share of transitions in Diff by the candidates' distance, beside the closed form."""
    scenario, law = system("sustained")
    runs, steps = 200, 200
    sample = simulate_runs(scenario, law, seed=SEED, runs=range(runs), steps=steps, record=True)
    delta = centre_distances(sample)
    distance = gauges_of(scenario, delta)
    edges = np.linspace(0, float(distance.max()) * (1 + 1e-12), BINS + 1)
    place = np.digitize(distance, edges) - 1
    D = scenario.plant.disturbance.half_widths
    D_c = scenario.defender.disturbance.half_widths
    assert D_c is not None
    rows = []
    for alpha in ALPHAS:
        expected = closed_form(delta, D, D_c, alpha)
        in_diff = (sample.symbol != NO_SYMBOL) & (sample.largest <= alpha)
        for i in range(BINS):
            here = place == i
            if here.any():
                middle = float(distance[here].mean())
                rows.append(
                    (
                        alpha,
                        runs,
                        steps,
                        SEED,
                        middle,
                        int(here.sum()),
                        int(in_diff[here].sum()),
                        float(expected[here].mean()),
                    )
                )
    columns = ("alpha", "runs", "steps", "seed", "distance", "transitions", "in_diff", "expected")
    write(path, columns, rows)


def tap_row(point: Point, runs: int, steps: int) -> tuple[Any, ...]:
    """What two taps get of a framed message under one kind of disturbance."""
    scenario = point.scenario
    law = make_law(scenario, cached_design(scenario))
    sample = simulate_runs(scenario, law, seed=SEED, runs=range(runs), steps=steps, record=True)
    sent = transfer(sample, payloads=[MESSAGE])
    heard = [listen(sample, sent, ("nearest-centre", "list-decoder"), r) for r in range(runs)]
    return (
        point.variant,
        scenario.secrecy.alpha,
        runs,
        steps,
        SEED,
        sum(nearest.agreements for nearest, _ in heard),
        sum(nearest.right for nearest, _ in heard),
        sum(decoder.delivered for _, decoder in heard),
        sum(decoder.read for _, decoder in heard),
    )


def measure_taps(path: Path, runs: int = TAP_RUNS, steps: int = TAP_STEPS) -> None:
    """What the taps get under each disturbance of the sweep ``disturbances``, at alpha = 8."""
    file = SWEEPS / "disturbances.toml"
    points = points_of(load_sweep(file), file.parent)
    chosen = [p for p in points if p.scenario.secrecy.alpha == max(ALPHAS)]
    columns = (
        "variant",
        "alpha",
        "runs",
        "steps",
        "seed",
        "agreements",
        "nearest_right",
        "delivered",
        "read_by_list_decoder",
    )
    write(path, columns, (tap_row(point, runs, steps) for point in chosen), TAP_SOURCES)


def measure_widths(path: Path) -> None:
    """Quantiles of the candidates' distance for each plant."""
    rows = []
    runs, steps = 30, 200
    for name in PLANTS:
        scenario, law = system(name)
        sample = simulate_runs(scenario, law, seed=SEED, runs=range(runs), steps=steps, record=True)
        distance = gauges_of(scenario, centre_distances(sample)).ravel()
        for q in np.linspace(0, 1, 101).tolist():
            rows.append((name, runs, steps, SEED, q, float(np.quantile(distance, q))))
    write(path, ("scenario", "runs", "steps", "seed", "quantile", "distance"), rows)


def measure_sets(path: Path) -> None:
    """Corners of some T_i, trajectories through them, and one step's picture (Fig. 4)."""
    scenario, law = system("sustained")
    rows: list[tuple[Any, ...]] = []
    for i in SHOWN_SETS:
        for x in planar_vertices(Polytope(*law.design.set(i))).tolist():
            rows.append((SEED, "set", f"T_{i}", i, *x))
    for name in ("paper", "sustained"):
        for start in INITIAL_STATES[:2]:
            base, one_law = system(name)
            run = simulate_runs(
                starting_at(base, start), one_law, seed=SEED, runs=range(1), steps=50, record=True
            )
            assert run.x is not None
            for k, x in enumerate(run.x[:, :, 0].tolist()):
                rows.append((SEED, "trajectory", f"{name} {start[0]:g}", k, *x))
    run = simulate_runs(scenario, law, seed=SEED, runs=range(1), steps=200, record=True)
    assert run.x is not None
    assert run.candidates is not None
    in_diff = (run.symbol[:, 0] != NO_SYMBOL) & (run.largest[:, 0] <= 3.0)
    k = int(np.flatnonzero(in_diff & (np.arange(200) >= 20))[0])
    x = run.x[k, :, 0].tolist()
    for i, u in enumerate(run.candidates[k, :, :, 0].tolist()):
        rows.append((SEED, "step", f"c_{i}", k, *predict(scenario.A, scenario.B, x, u)))
    rows.append((SEED, "step", "x(k+1)", k, *run.x[k + 1, :, 0].tolist()))
    widths = Gauge.from_rows(*scenario.defender.disturbance.rows()).half_widths
    assert widths is not None
    rows.append((SEED, "step", "D_c", k, *widths))
    write(path, ("seed", "kind", "name", "index", "x_1", "x_2"), rows)


def measure_sweep(name: str) -> Callable[[Path], None]:
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

    return measure


def measure_rows(
    columns: Sequence[str],
    rows: Callable[[], Iterable[Sequence[Any]]],
    sources: Sequence[str] = signalling.SOURCES,
) -> Callable[[Path], None]:
    """The measurement of a study of docs/findings.md, or of docs/keys.md."""

    def measure(path: Path) -> None:
        write(path, columns, rows(), sources)

    return measure


FIGURE_SWEEPS: Final = (
    "fig7-paper-20",
    "fig7-paper",
    "fig7-sustained",
    "sustained-long",
    "disturbances",
    "price",
    "plants",
)

MEASUREMENTS: Final[dict[str, Callable[[Path], None]]] = {
    **{name: measure_sweep(name) for name in FIGURE_SWEEPS},
    "distance": measure_distance,
    "taps": measure_taps,
    "widths": measure_widths,
    "sets": measure_sets,
    **{f"secrecy-{study}": measure_study(study) for study in STUDIES},
    "signalling-rates": measure_rows(signalling.RATE_COLUMNS, signalling.rate_rows),
    "signalling-price": measure_rows(signalling.PRICE_COLUMNS, signalling.price_rows),
    "two-step": measure_rows(signalling.CODE_COLUMNS, signalling.code_rows),
    "block-codes": measure_rows(signalling.BLOCK_COLUMNS, signalling.block_rows),
    "noise-bound": measure_rows(noise.COLUMNS, noise.bound_rows, noise.SOURCES),
    "secrecy-shape": measure_rows(shape.COLUMNS, shape.shape_rows, shape.SOURCES),
    "missed-steps": measure_rows(
        missed_steps.COLUMNS, missed_steps.missed_rows, missed_steps.SOURCES
    ),
    "other-sets": measure_rows(other_sets.COLUMNS, other_sets.other_set_rows, other_sets.SOURCES),
    "readings": measure_rows(readings.COLUMNS, readings.reading_rows, readings.SOURCES),
    "corners": measure_rows(corners.COLUMNS, corners.corner_rows, corners.SOURCES),
    "outputs": measure_rows(outputs.COLUMNS, outputs.output_rows, outputs.SOURCES),
    "waiting": measure_rows(waiting.COLUMNS, waiting.waiting_rows, waiting.SOURCES),
    "network": measure_rows(network.COLUMNS, network.network_rows, network.SOURCES),
    "key-controls": measure_rows(keys.CONTROL_COLUMNS, keys.control_rows, keys.SOURCES),
    "attacks": attacks.add_rows,
    "dither-price": measure_rows(watermark.COLUMNS, watermark.price_rows, watermark.SOURCES),
}
"""How each data file of docs/data is made."""
