"""The highest pace that misses nothing, and how long offers take at several rates.

The three services of one loop, on loopback with the tap attached, in real time: each rate is a run
of its own. A rate holds when none of 10,000 steps is missed, after the first hundred; one that has
missed a step is not run to its end.
"""

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from benchmarks.fleet import quantile_ms
from benchmarks.loop import SCENARIO, ServiceProcess, running
from runtime.recording import parts_of, read_lines
from runtime.run_folder import PLANT_STATUS, PLANT_TRACE
from runtime.scenario_file import load_scenario

STEPS: Final = 10_000
"""Steps in which a rate must not miss any."""

WARM_UP: Final = 100
"""Steps at the beginning that do not count."""

PROBE_S: Final = 5.0
PROBE_STEPS: Final = 1000
"""Seconds, and steps at most, of a first look at a rate."""

POLL_S: Final = 1.0
"""Time between two looks at a run that ends with its first missed step."""

RATES_HZ: Final = (20, 50, 100, 150, 200, 300, 400, 500, 700, 1000)
SHOWN_HZ: Final = {10: 200, 100: 1500, 500: 5000, 1000: 10_000}
"""Rates whose latencies are shown, with the steps of each run."""

TARGET_HZ: Final = 200
PATIENCE_S: Final = 60.0


def run_at(
    rate_hz: float, steps: int, scenario: Path = SCENARIO, *, until_missed: bool = False
) -> dict[str, Any]:
    """One run at a rate.

    Parameters
    ----------
    rate_hz : float
    steps : int
        That count; there are `WARM_UP` before them.
    scenario : Path
    until_missed : bool
        End it about a second after the first missed step.

    Returns
    -------
    dict
        ``missed`` after the warm-up, ``steps`` made after it, and ``p50_ms``, ``p99_ms``,
        ``p999_ms`` of the offers (upper bounds of their buckets).

    Raises
    ------
    runtime.errors.Failure
        When a service fails.
    """
    factor = rate_hz * load_scenario(scenario).plant.period_s
    with tempfile.TemporaryDirectory(prefix="wyner-pace-") as name:
        folder = Path(name)
        with running(scenario, folder, steps + WARM_UP, pace=f"x{factor:g}") as services:
            if until_missed:
                _wait_for_a_miss(services["plant"], folder)
            services["plant"].wait(PATIENCE_S + 2 * steps / rate_hz)
        status = json.loads((folder / PLANT_STATUS).read_bytes())
        lines = [line.value or {} for p in parts_of(folder / PLANT_TRACE) for line in read_lines(p)]
        counts = status["timing"]["latency_counts"]
        missed = sum(line.get("event") == "missed" and line["k"] >= WARM_UP for line in lines)
    return {
        "rate_hz": rate_hz,
        "steps": max(status["step"]["k"] - WARM_UP, 0),
        "missed": missed,
        "p50_ms": quantile_ms(counts, 0.5),
        "p99_ms": quantile_ms(counts, 0.99),
        "p999_ms": quantile_ms(counts, 0.999),
    }


def _wait_for_a_miss(plant: ServiceProcess, folder: Path) -> None:
    """Wait until a plant has missed a step after the warm-up, and ask it to end; or for its end."""
    in_warm_up: int | None = None
    while plant.process.poll() is None:
        time.sleep(POLL_S)
        try:
            status = json.loads((folder / PLANT_STATUS).read_bytes())
        except FileNotFoundError:
            continue
        if status["step"]["k"] < WARM_UP:
            continue
        if in_warm_up is None:
            in_warm_up = status["step"]["missed"]
        elif status["step"]["missed"] > in_warm_up:
            plant.process.terminate()
            return


def measure(
    *,
    steps: int = STEPS,
    rates: tuple[int, ...] = RATES_HZ,
    shown: dict[int, int] = SHOWN_HZ,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Find the highest rate that holds, and measure the latencies.

    A first look goes up the rates until one misses a step in twenty; from the one before it the
    full runs go down until one holds, each until its first missed step.

    Parameters
    ----------
    steps : int
        Of a full run.
    rates : tuple of int
        Tried, in rising order, Hz.
    shown : dict
        Steps of a run by rate, for the table of latencies.
    progress : callable, optional
        Told in a line how each run went.

    Returns
    -------
    dict
        ``highest_hz`` (0 where no rate holds), ``target_hz``, ``steps``, ``tried`` (full runs),
        ``latencies`` (one row a rate), as :func:`run_at` has them.
    """
    say = progress or (lambda _line: None)

    def run(rate: float, n: int, *, until_missed: bool = False) -> dict[str, Any]:
        row = run_at(rate, n, until_missed=until_missed)
        made, missed = row["steps"], row["missed"]
        say(f"{rate:g} Hz, {made} steps: {missed} missed, p99 <= {row['p99_ms']:g} ms")
        return row

    reachable = 0
    for rate in rates:
        probe = min(PROBE_STEPS, round(PROBE_S * rate), steps)
        if run(rate, probe)["missed"] > probe / 20:
            break
        reachable += 1
    tried: list[dict[str, Any]] = []
    for rate in reversed(rates[:reachable]):
        tried.append(run(rate, steps, until_missed=True))
        if not tried[-1]["missed"]:
            break
    holds = [row["rate_hz"] for row in tried if not row["missed"]]
    return {
        "highest_hz": max(holds, default=0),
        "target_hz": TARGET_HZ,
        "steps": steps,
        "tried": tried,
        "latencies": [run(rate, n) for rate, n in shown.items()],
    }


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` for people."""
    highest = result["highest_hz"]
    lines = [
        f"highest rate without a missed step in {result['steps']}: {highest} Hz   (target "
        f"{result['target_hz']}: {'reached' if highest >= result['target_hz'] else 'MISSED'})"
    ]
    lines += [
        f"  {row['rate_hz']:>5} Hz: {row['missed']} missed of {row['steps']}"
        for row in result["tried"]
    ]
    lines += ["", "tick to offer, at most (ms)        p50     p99   p99.9   missed"]
    lines += [
        f"  {row['rate_hz']:>5} Hz                    {row['p50_ms']:>7g} {row['p99_ms']:>7g} "
        f"{row['p999_ms']:>7g}   {row['missed']} of {row['steps']}"
        for row in result["latencies"]
    ]
    return "\n".join(lines)
