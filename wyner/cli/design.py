"""``wyner design``: a scenario's sets, gains and settled rate; the list of shipped scenarios."""

import argparse
import json
from typing import TYPE_CHECKING, Any

from runtime.errors import DONE, FAILED, Failure, UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design
    from protocol.scenario import Scenario
    from wyner.advice.answer import Answer
    from wyner.advice.rate import SettledRate
    from wyner.advice.why import Why


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    from controller_service.progress import PATIENCE_S

    parser.description = (
        "Compute the sets T_0..T_N of SCENARIO (or read them from the cache), check "
        "them, and estimate the rate at which the link settles by seeded simulations of the loop. "
        "With --list, list the shipped scenarios. With --knowledge, write as JSON what the paper's "
        "eavesdropper knows of SCENARIO: f_c and D_e, and neither D_c nor alpha. A tap on a "
        "machine of its own needs this file and no scenario (wyner tap --knowledge FILE)."
    )
    parser.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="a TOML file or a shipped name"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="list the shipped scenarios")
    what.add_argument(
        "--knowledge",
        nargs="?",
        const="",
        metavar="FILE",
        help="write what the eavesdropper of SCENARIO is told (default: standard output)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--no-cache", action="store_true", help="compute, and store nothing")
    parser.add_argument(
        "--patience",
        type=float,
        default=PATIENCE_S,
        metavar="S",
        help=f"refuse a design that will take longer (default: {PATIENCE_S:g} seconds)",
    )
    parser.add_argument("--plot", metavar="F", help="draw what is shown, as F.png, F.pdf or F.svg")


def run(args: argparse.Namespace) -> int:
    """Show the design, or what else was asked for."""
    from wyner.cli.scenarios import list_scenarios, write_knowledge

    if args.list:
        if args.scenario is not None:
            raise UsageError(f"--list: got SCENARIO {args.scenario!r} as well, expected none")
        return list_scenarios(as_json=args.json)
    if args.scenario is None:
        raise UsageError("SCENARIO: expected a TOML file or a shipped name (--list shows them)")
    if args.knowledge is not None:
        return write_knowledge(args.scenario, args.knowledge)
    return _show_design(args)


def _show_design(args: argparse.Namespace) -> int:
    import time

    from controller_service.laws.online import ProgramError
    from controller_service.laws.registry import cached_design, make_law, synthesise
    from controller_service.progress import shown_progress
    from controller_service.sets.design import SynthesisError
    from runtime.scenario_file import scenario_of
    from runtime.shipped import scenario_file_of

    scenario = scenario_of(args.scenario)
    if not args.patience > 0:
        raise UsageError(f"--patience: got {args.patience:g}, expected more than 0")
    begin = time.perf_counter()
    try:
        with shown_progress(args.patience) as progress:
            design = (synthesise if args.no_cache else cached_design)(scenario, progress)
        law = make_law(scenario, design)
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{args.scenario}: {error}") from None
    result = describe(scenario, design, law)
    result["seconds"] = round(design.seconds, 4)
    result["ready_seconds"] = round(time.perf_counter() - begin, 4)
    carries = under_keys(scenario)
    linear = scenario.plant.kind == "linear" and scenario.plant.disturbance.enters != "input"
    linear = linear and carries is None
    folder = scenario_file_of(args.scenario).parent
    rate, reasons, found = (linear and _rate(scenario, law, folder)) or (None, None, None)
    result["answer"] = None if found is None else found.as_json()
    result["rate"] = None if rate is None else rate.as_json()
    result["simulated"] = linear
    result["under_keys"] = carries
    result["network"] = expected_misses(scenario, folder)
    result["why"] = None if reasons is None else reasons.as_json()
    drawn = [] if args.plot is None else [str(_plot(args.plot, scenario, design, law))]
    if args.json:
        print(json.dumps(result))
    else:
        first = [] if found is None else found.lines()
        rates = _rate_lines(rate, linear=linear) if carries is None else [_sealed_line(carries)]
        shown = [*first, render(result), *rates]
        print("\n".join([*shown, *(() if reasons is None else reasons.lines()), *drawn]))
    return FAILED if linear and rate is None else DONE


def _rate_lines(rate: "SettledRate | None", *, linear: bool) -> list[str]:
    """The rate for people, or why there is none."""
    if rate is not None:
        return rate.lines()
    if linear:
        return ["settled rate: none, the loop cannot start or leaves the sets"]
    return ["settled rate: not simulated, as plant code runs in the plant alone"]


def under_keys(scenario: "Scenario") -> dict[str, Any] | None:
    """What a message under distilled keys can have; None under a scheme that agrees its own.

    A step carries a symbol where it has its digits. Keys give so many at most, where nothing is
    lost.
    """
    from math import log2

    from protocol.schemes.registry import scheme_named
    from protocol.secret.key_digits import KEY_BITS, WORD_BITS, digits_per_word

    schedule = None if scenario.keys is None else scenario.keys.schedule()
    if schedule is None or not scheme_named(scenario.secrecy.scheme).from_stream:
        return None
    a, N, M = schedule.assumption, schedule.largest, scenario.secrecy.candidates
    keys = a.rows(N, N, a.copies * N) - 1
    digits = keys * KEY_BITS // WORD_BITS * digits_per_word(M)[0]
    steps = digits / (N * scenario.digits)
    rate = min(1.0, steps) * log2(M) / scenario.plant.period_s
    return {"bits_per_second_at_most": rate, "first_step": schedule.first_use}


def _sealed_line(found: dict[str, Any]) -> str:
    return (
        f"message rate: {found['bits_per_second_at_most']:.3g} bit/s at most, from step "
        f"{found['first_step']} on at the earliest: each symbol travels under distilled keys"
    )


def _rate(
    scenario: "Scenario", law: "CandidateLaw", folder: "Path"
) -> "tuple[SettledRate, Why | None, Answer] | None":
    """The rate, why it is what it is, and what it is worth.

    None where the loop cannot start or leaves the sets.
    """
    from wyner.advice.answer import answer
    from wyner.advice.rate import long_runs, settled_rate
    from wyner.advice.why import why
    from wyner.simulate.engine import SimulationError

    try:
        runs = long_runs(scenario, law, folder, record=True)
    except SimulationError:
        return None
    rate = settled_rate(runs)
    found = answer(scenario, law.design, runs, rate.settled)
    if scenario.plant.C is not None:
        return rate, None, found
    if scenario.network is not None:
        whole = scenario.model_copy(update={"network": None})
        try:
            runs = long_runs(whole, law, folder, record=True)
        except SimulationError:
            return rate, None, found
    if scenario.defender.deviations is not None:  # no set decides there
        return rate, None, found
    return rate, why(scenario, runs), found


def _plot(text: str, scenario: "Scenario", design: "Design", law: "CandidateLaw") -> "Path":
    from wyner.cli.drawing import drawn_to

    def draw(figure: "Figure") -> str:
        from wyner.drawing.design import draw_design
        from wyner.simulate.engine import SimulationError

        try:
            return draw_design(figure, scenario, design, law)
        except SimulationError as error:
            raise Failure(f"--plot: {error}") from None

    return drawn_to("--plot", text, (9.0, 4.2), draw)


def describe(scenario: "Scenario", design: "Design", law: "CandidateLaw") -> dict[str, Any]:
    """The design's figures as one object for machines."""
    from controller_service.laws.online import OutsideError
    from controller_service.sets.dead_link import dead_link_budget
    from controller_service.sets.invariance import invariance
    from protocol.convex import Polytope, corners, planar_area

    N, found = design.horizon, scenario.defender.calibration
    shown = sorted({i for i in (0, 1, 2, 5, 10, 20, 50, 100, 150, 200, 250, N) if i <= N})
    sets = []
    for i in shown:
        entry: dict[str, Any] = {"index": i, "facets": design.facets[i]}
        if scenario.n == 1:
            entry["interval"] = corners(*design.set(i))[:, 0].tolist()
        elif scenario.n == 2:
            entry["area"] = planar_area(Polytope(*design.set(i)))
        sets.append(entry)
    start: dict[str, Any] = {"state": list(scenario.initial_state)}
    try:
        start["index"] = law.index(scenario.initial_state)
    except OutsideError as error:
        start["outside"] = str(error)
    D_c = scenario.control.disturbance
    return {
        "scenario": scenario.name,
        "law": scenario.control.law,
        "states": scenario.n,
        "inputs": scenario.m,
        "horizon": N,
        "horizon_asked": scenario.control.horizon,
        "stopped": design.stopped,
        "gain": design.K.tolist(),
        "gain_source": "given" if design.gain_given else "linear quadratic regulator",
        "terminal": vars(design.terminal),
        "invariance": invariance(scenario, design),
        "sets": sets,
        "largest_deflation": 2 * max(design.margins),
        "start": start,
        "fallback": scenario.link.fallback,
        "dead_link_steps": dead_link_budget(scenario, design),
        "control_set": None if D_c is None else D_c.model_dump(exclude_none=True),
        "noisy": scenario.defender.noise is not None,
        "calibration": None if found is None else found.model_dump(),
        "cached": design.cached,
        "fingerprint": scenario.design_fingerprint(),
    }


def expected_misses(scenario: "Scenario", folder: "Path") -> dict[str, Any] | None:
    """The share of missed steps to expect of the scenario's network; None where it has none.

    Counted over simulated messages.
    """
    from protocol.statistics import share_over_runs
    from wyner.advice.rate import RUNS, SEED, STEPS
    from wyner.simulate.missed import missed_steps

    missed = missed_steps(scenario, seed=SEED, runs=range(RUNS), steps=STEPS, folder=folder)
    if missed is None:
        return None
    share = share_over_runs([(int(m), STEPS) for m in missed.sum(axis=0)]).as_json()
    return {
        "missed_share": share["value"],
        "interval_95": [share["low"], share["high"]],
        "runs": RUNS,
        "steps": STEPS,
        "seed": SEED,
    }


def network_lines(found: dict[str, Any] | None) -> list[str]:
    """What the network costs in steps, in a line."""
    if found is None:
        return []
    share = f"network: {100 * found['missed_share']:.3g} % of steps missed"
    low, high = (100 * limit for limit in found["interval_95"])
    return [
        f"{share} [{low:.3g}, {high:.3g}] in {found['runs']} runs of {found['steps']} steps, seed "
        f"{found['seed']}; none in lock-step"
    ]


INVARIANCE = {
    "gain": "T_0 is robust invariant under u = K x, and K T_0 is within U (checked to 1e-9)",
    "control": "T_0 is robust invariant under some input in U at each state, not u = K x (checked)",
    None: "T_0 was not found to be robust invariant, under u = K x or any input in U",
}
"""What was found of T_0, by :func:`controller_service.sets.invariance.invariance`."""


def _ended(r: dict[str, Any]) -> str:
    """Why there are fewer sets than were asked."""
    if r["stopped"]:
        return (
            "larger ones are so long beside their width that rounding could put states into them "
            "that no input steers"
        )
    return "they stop growing there"


def render(r: dict[str, Any]) -> str:
    """The object in lines for people."""
    import numpy as np

    when = "read from the cache, computed once in" if r["cached"] else "computed in"
    lines = [
        f"{r['scenario']}: {r['states']} state(s), {r['inputs']} input(s), law {r['law']}",
        f"sets T_0..T_{r['horizon']} {when} {r['seconds']:.3f} s"
        + (
            f" ({_ended(r)}; {r['horizon_asked']} were asked)"
            if r["horizon"] < r["horizon_asked"]
            else ""
        ),
        f"K ({r['gain_source']}): " + "; ".join(" ".join(f"{v:.6g}" for v in k) for k in r["gain"]),
    ]
    t = r["terminal"]
    if t["method"] == "rakovic":
        lines.append(
            f"T_0: Rakovic's approximation of order {t['order']}, alpha {t['alpha']:.3g}, within "
            f"{t['bound']:.3g} of the minimal invariant set"
        )
    elif t["method"] == "interval":
        lines.append("T_0: the minimal invariant interval")
    elif t["method"] == "modal":
        lines.append(f"T_0: parallelepiped in the modes of A + B K, radius {t['bound']:.3g}")
    elif t["method"] == "invariant":
        lines.append(f"T_0: the largest set that any control keeps, radius {t['bound']:.3g}")
    else:
        lines.append(f"T_0: {t['method']}")
    lines.append(INVARIANCE[r["invariance"]])
    extent = next((name for name in ("area", "interval") if name in r["sets"][0]), "")
    lines.append(f"{'index':>7} {'facets':>7}  {extent}".rstrip())
    for s in r["sets"]:
        values = np.atleast_1d(s.get(extent, ()))
        shown = " to ".join(f"{v:.6g}" for v in values)
        lines.append(f"{s['index']:>7} {s['facets']:>7}  {shown}".rstrip())
    start = r["start"]
    lines.append(
        f"initial state {start['state']}: "
        + (
            f"index {start['index']}"
            if "index" in start
            else f"{start['outside']}; start nearer to the origin, or enlarge control.horizon"
        )
    )
    lines += safety_lines(r)
    lines += network_lines(r["network"])
    return "\n".join(lines)


def safety_lines(r: dict[str, Any]) -> list[str]:
    """What a dead link may do, which sets are in use, and what was promised of D_c."""
    steps = r["dead_link_steps"]
    lasts = (
        "no number of steps leads outside T_N"
        if steps is None
        else f"every state of T_0 lasts {steps} step{'' if steps == 1 else 's'}, whatever d, "
        "before it may leave T_N"
    )
    lines = [f"dead link, fallback {r['fallback']}: {lasts}"]
    if r["control_set"] is not None:
        lines.append("the sets resist control.disturbance, which is larger than the test's D_c")
    c, what = r["calibration"], "W = D_c + N - A N" if r["noisy"] else "D_c"
    if c is not None:
        lines.append(
            f"{what}: a session of {c['steps']} steps leaves it with probability at most "
            f"{c['violation']:.3g}, confidence {c['confidence']:g} ({c['exceeded']} of "
            f"{c['sessions']} fresh sessions did)"
        )
    return lines
