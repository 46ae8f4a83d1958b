"""What ``wyner design`` says of a scenario: what it is worth, its sets, gain and rate."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from math import log2
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import OutsideError
from controller_service.laws.registry import cached_design, make_law
from controller_service.progress import shown_progress
from controller_service.sets.dead_link import dead_link_budget
from controller_service.sets.design import Design
from controller_service.sets.invariance import invariance
from controller_service.sets.terminal import Terminal
from protocol.convex import Polytope, corners, planar_area
from protocol.scenario import Scenario
from protocol.schemes.registry import scheme_named
from protocol.secret.key_digits import KEY_BITS, WORD_BITS, digits_per_word
from protocol.statistics import Interval, share_over_runs
from wyner.advice import rate as settling
from wyner.advice.answer import Answer, answer
from wyner.advice.rate import SettledRate, long_runs, settled_rate
from wyner.advice.why import Why, why
from wyner.printout import Printout
from wyner.simulate.engine import SimulationError
from wyner.simulate.missed import missed_steps

SHOWN: Final = (0, 1, 2, 5, 10, 20, 50, 100, 150, 200, 250)
"""Indices of the sets that are listed, beside the largest."""

INVARIANCE: Final = {
    "gain": "T_0 is robust invariant under u = K x, and K T_0 is within U (checked to 1e-9)",
    "control": "T_0 is robust invariant under some input in U at each state, not u = K x (checked)",
    None: "T_0 was not found to be robust invariant, under u = K x or any input in U",
}
"""What was found of T_0, by :func:`controller_service.sets.invariance.invariance`."""


@dataclass(frozen=True, eq=False)
class DesignReport(Printout):
    """What a scenario's design is worth; its lines begin with secrecy, cost and attack.

    Parameters
    ----------
    scenario : Scenario
    law : CandidateLaw
        With the design, its sets and gain.
    carries_nothing : bool
        Whether the loop was simulated, and cannot start or leaves the sets.
    """

    scenario: Scenario
    law: CandidateLaw
    carries_nothing: bool


def design_report(scenario: Scenario, folder: Path) -> DesignReport:
    """Compute or read the design, and simulate the loop.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Where the files are that the scenario names.

    Raises
    ------
    SynthesisError, ProgramError
        When there are no sets, or no law on them.
    """
    begin = time.perf_counter()
    with shown_progress() as progress:
        design = cached_design(scenario, progress)
    law = make_law(scenario, design)
    ready = time.perf_counter() - begin
    keyed = _under_keys(scenario)
    linear = scenario.plant.kind == "linear" and scenario.plant.disturbance.enters != "input"
    simulated = linear and keyed is None
    rate, reasons, worth = _worth(scenario, law, folder) if simulated else (None, None, None)
    missed = _missed(scenario)
    control_set, calibration = scenario.control.disturbance, scenario.defender.calibration
    figures = {
        "scenario": scenario.name,
        "law": scenario.control.law,
        "states": scenario.n,
        "inputs": scenario.m,
        "horizon": design.horizon,
        "horizon_asked": scenario.control.horizon,
        "stopped": design.stopped,
        "gain": design.K.tolist(),
        "gain_source": "given" if design.gain_given else "linear quadratic regulator",
        "terminal": vars(design.terminal),
        "invariance": invariance(scenario, design),
        "sets": _sets(scenario, design),
        "largest_deflation": 2 * max(design.margins),
        "start": _start(scenario, law),
        "fallback": scenario.link.fallback,
        "dead_link_steps": dead_link_budget(scenario, design),
        "control_set": None if control_set is None else control_set.model_dump(exclude_none=True),
        "noisy": scenario.defender.noise is not None,
        "calibration": None if calibration is None else calibration.model_dump(),
        "cached": design.cached,
        "fingerprint": scenario.design_fingerprint(),
        "seconds": round(design.seconds, 4),
        "ready_seconds": round(ready, 4),
        "answer": None if worth is None else worth.as_json(),
        "rate": None if rate is None else rate.as_json(),
        "simulated": simulated,
        "under_keys": keyed,
        "network": None if missed is None else _of_network(missed),
        "why": None if reasons is None else reasons.as_json(),
    }
    lines = [] if worth is None else [*worth.lines(), ""]
    lines += _of_sets(design, figures)
    lines += _of_safety(scenario, figures, missed)
    lines.append("")
    lines += [_without_rate(figures)] if rate is None else rate.lines()
    lines += [] if reasons is None else reasons.lines()
    return DesignReport(figures, lines, scenario, law, simulated and rate is None)


def _worth(
    scenario: Scenario, law: CandidateLaw, folder: Path
) -> tuple[SettledRate | None, Why | None, Answer | None]:
    """The rate, why it is what it is, and what it is worth.

    None where the loop cannot start or leaves the sets; no reasons where no set decides.
    """
    try:
        runs = long_runs(scenario, law, folder, record=True)
    except SimulationError:
        return None, None, None
    rate = settled_rate(runs)
    found = answer(scenario, law.design, runs, rate.settled)
    if scenario.plant.C is not None or scenario.defender.deviations is not None:
        return rate, None, found
    if scenario.network is not None:
        whole = scenario.model_copy(update={"network": None})
        try:
            runs = long_runs(whole, law, folder, record=True)
        except SimulationError:
            return rate, None, found
    return rate, why(scenario, runs), found


def _under_keys(scenario: Scenario) -> dict[str, float] | None:
    """What a message under distilled keys can have at most, and the first step that has a key.

    None under a scheme that agrees its own keys. A step carries a symbol where it has its digits.
    Keys give so many at most, where nothing is lost.
    """
    schedule = None if scenario.keys is None else scenario.keys.schedule()
    if schedule is None or not scheme_named(scenario.secrecy.scheme).from_stream:
        return None
    a, N, M = schedule.assumption, schedule.largest, scenario.secrecy.candidates
    keys = a.rows(N, N, a.copies * N) - 1
    digits = keys * KEY_BITS // WORD_BITS * digits_per_word(M)[0]
    steps = digits / (N * scenario.digits)
    rate = min(1.0, steps) * log2(M) / scenario.plant.period_s
    return {"bits_per_second_at_most": rate, "first_step": schedule.first_use}


def _missed(scenario: Scenario) -> Interval | None:
    """The share of steps that the scenario's network misses; None where it has none."""
    runs = range(settling.RUNS)
    missed = missed_steps(scenario, seed=settling.SEED, runs=runs, steps=settling.STEPS)
    if missed is None:
        return None
    return share_over_runs([(int(m), settling.STEPS) for m in missed.sum(axis=0)])


def _of_network(missed: Interval) -> dict[str, Any]:
    share = missed.as_json()
    interval = [share["low"], share["high"]]
    about = {"runs": settling.RUNS, "steps": settling.STEPS, "seed": settling.SEED}
    return {"missed_share": share["value"], "interval_95": interval, **about}


def _sets(scenario: Scenario, design: Design) -> list[dict[str, Any]]:
    """Facets, and interval or area, of some of the sets."""
    out = []
    for i in sorted({*(i for i in SHOWN if i <= design.horizon), design.horizon}):
        entry: dict[str, Any] = {"index": i, "facets": design.facets[i]}
        if scenario.n == 1:
            entry["interval"] = corners(*design.set(i))[:, 0].tolist()
        elif scenario.n == 2:
            entry["area"] = planar_area(Polytope(*design.set(i)))
        out.append(entry)
    return out


def _start(scenario: Scenario, law: CandidateLaw) -> dict[str, Any]:
    """The initial state with its index, or why it has none."""
    state = scenario.initial_state
    try:
        return {"state": list(state), "index": law.index(state)}
    except OutsideError as error:
        return {"state": list(state), "outside": str(error)}


def _of_sets(design: Design, told: dict[str, Any]) -> Iterator[str]:
    size = f"{told['states']} state(s), {told['inputs']} input(s)"
    yield f"{told['scenario']}: {size}, law {told['law']}"
    when = "read from the cache, computed once in" if design.cached else "computed in"
    fewer = ""
    if design.horizon < told["horizon_asked"]:
        why_fewer = "they stop growing there"
        if design.stopped:
            why_fewer = (
                "larger ones are so long beside their width that rounding could put states into "
                "them that no input steers"
            )
        fewer = f" ({why_fewer}; {told['horizon_asked']} were asked)"
    yield f"sets T_0..T_{design.horizon} {when} {design.seconds:.3f} s{fewer}"
    # what rounding has left of a zero is shown as one
    rows = "; ".join(" ".join(f"{round(v, 12) + 0.0:.6g}" for v in row) for row in told["gain"])
    yield f"K ({told['gain_source']}): {rows}"
    yield _terminal(design.terminal)
    yield INVARIANCE[told["invariance"]]
    extent = {1: "interval", 2: "area"}.get(told["states"], "")
    yield f"{'index':>7} {'facets':>7}  {extent}".rstrip()
    for one in told["sets"]:
        shown = " to ".join(f"{v:.6g}" for v in np.atleast_1d(one.get(extent, [])))
        yield f"{one['index']:>7} {one['facets']:>7}  {shown}".rstrip()
    start = told["start"]
    where = f"index {start['index']}" if "index" in start else start["outside"]
    if "outside" in start:
        where += "; start nearer to the origin, or enlarge control.horizon"
    yield f"initial state {start['state']}: {where}"


def _terminal(t: Terminal) -> str:
    if t.method == "rakovic":
        return (
            f"T_0: Rakovic's approximation of order {t.order}, contraction {t.alpha:.3g}, "
            f"within {t.bound:.3g} of the minimal invariant set"
        )
    kinds = {
        "interval": "the minimal invariant interval",
        "modal": f"parallelepiped in the modes of A + B K, radius {t.bound:.3g}",
        "invariant": f"the largest set that any control keeps, radius {t.bound:.3g}",
    }
    return f"T_0: {kinds.get(t.method, t.method)}"


def _of_safety(scenario: Scenario, told: dict[str, Any], missed: Interval | None) -> Iterator[str]:
    steps = told["dead_link_steps"]
    lasts = "the plant stays inside T_N for ever"
    if steps is not None:
        lasts = (
            f"every state of T_0 lasts {steps} step{'' if steps == 1 else 's'}, whatever d, "
            "before it may leave T_N"
        )
    yield f"dead link, fallback {told['fallback']}: {lasts}"
    if told["control_set"] is not None:
        yield "the sets resist control.disturbance, which is larger than the test's D_c"
    c = scenario.defender.calibration
    what = "W = D_c + N - A N" if told["noisy"] else "D_c"
    if c is not None:
        yield (
            f"{what}: a session of {c.steps} steps leaves it "
            f"with probability at most {c.violation:.3g}, confidence {c.confidence:g} "
            f"({c.exceeded} of {c.sessions} fresh sessions did)"
        )
    if missed is not None:
        yield (
            f"network: {missed.scaled(100.0).text('.3g', ' %')} of steps missed, in "
            f"{settling.RUNS} runs of {settling.STEPS} steps, seed {settling.SEED}; none in "
            "lock-step"
        )


def _without_rate(told: dict[str, Any]) -> str:
    """Why there is no settled rate."""
    if (keyed := told["under_keys"]) is not None:
        return (
            f"message rate: {keyed['bits_per_second_at_most']:.3g} bit/s at most, from "
            f"step {keyed['first_step']} on at the earliest: each symbol travels under "
            "distilled keys, and is secret while their claim holds"
        )
    if told["simulated"]:
        return "settled rate: none, the loop cannot start or leaves the sets"
    return "settled rate: not simulated, as plant code runs in the plant alone"
