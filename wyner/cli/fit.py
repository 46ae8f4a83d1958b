"""``wyner fit``: a model and a D_c, from a recording or from a plant that is run for it."""

import argparse
import json
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from protocol.statistics import STATED
from runtime.errors import DONE, Failure, UsageError, writing
from runtime.files import write_atomically

if TYPE_CHECKING:
    from wyner.fit.fitting import Plan


RECORDED_VIOLATION: Final = 0.01
"""Share of recorded steps that may leave D_c, for its scale."""

CONFIDENCE: Final = 0.999

OF_A_PLANT: Final = (
    "sessions",
    "excite_steps",
    "steps",
    "seed",
    "amplitude",
    "noise",
)
"""Options that say how a plant is run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "With --states, --inputs and --period, read a recording (CSV, or MATLAB's .mat): identify "
        "A and B from its first half, scale D_c with the third quarter, count the steps of the "
        "last quarter that leave it, and write a scenario. Without them FILE is a scenario, and "
        "its plant is run: excited, to identify A and B where the file has none; then in whole "
        "sessions under the law, until D_c stands still; then in fresh sessions, which certify it."
    )
    parser.add_argument(
        "scenario", metavar="FILE", help="a recording; or a scenario, by file or shipped name"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    parser.add_argument("--states", metavar="NAMES", help="columns of the states: a,b,c")
    parser.add_argument("--inputs", metavar="NAMES", help="columns of the inputs: u or u1,u2")
    parser.add_argument("--period", type=float, metavar="S", help="seconds from row to row")
    parser.add_argument("--json", action="store_true", help="one object on standard output")
    numbers: tuple[tuple[str, float, str], ...] = (
        ("--sessions", 100, "sessions that scale D_c, and as many that certify it"),
        ("--steps", 200, "steps of a session under the law"),
        ("--excite-steps", 100, "steps of one with random inputs; few for an unstable plant"),
        ("--seed", 1, "seed of excitation, coins and disturbance"),
        ("--amplitude", 0.3, "of the random inputs, as a share of U"),
        ("--confidence", 0.999, "of what is said of D_c"),
    )
    for option, default, text in numbers:
        kind, metavar = (int, "N") if isinstance(default, int) else (float, "P")
        parser.add_argument(option, type=kind, metavar=metavar, help=f"{text} ({default})")

    parser.add_argument(
        "--violation",
        type=float,
        metavar="P",
        help="share of sessions (0.05) or of recorded steps (0.01) that may leave D_c",
    )
    parser.add_argument(
        "--noise",
        type=float,
        metavar="K",
        help="take the sensors' noise N from the readings: K standard deviations of it; "
        "else defender.noise counts as stated",
    )


def run(args: argparse.Namespace) -> int:
    """Fit, write, tell."""
    if args.output.is_dir() or not args.output.parent.is_dir():
        raise UsageError(f"--output: got {str(args.output)!r}, expected a file in a folder")
    if (args.states, args.inputs, args.period) != (None, None, None):
        return _fit_recording(args)
    if Path(args.scenario).suffix.lower() in (".csv", ".mat"):
        raise UsageError(
            f"{args.scenario}: a recording wants --states NAMES, --inputs NAMES and --period S"
        )
    return _fit_plant(args)


def _fit_recording(args: argparse.Namespace) -> int:
    from protocol.scenario.reading import LARGEST_NUMBER
    from wyner.fit.first_scenario import HORIZONS, WIDER, FirstScenario
    from wyner.fit.identification import FitError
    from wyner.fit.recording import fit_recording, read_recording

    if None in (args.states, args.inputs, args.period):
        raise UsageError("expected --states, --inputs and --period together")
    if not 0 < args.period <= LARGEST_NUMBER:
        raise UsageError(f"--period: got {args.period:g}, expected more than 0")
    for name in OF_A_PLANT:
        if getattr(args, name) is not None:
            option = name.replace("_", "-")
            raise UsageError(f"--{option}: is for a plant that is run, and not for a recording")
    violation = RECORDED_VIOLATION if args.violation is None else args.violation
    confidence = CONFIDENCE if args.confidence is None else args.confidence
    _check_share("violation", violation)
    _check_share("confidence", confidence)
    states, inputs = _names("--states", args.states), _names("--inputs", args.inputs)
    if (len(states), len(inputs)) not in HORIZONS:
        raise UsageError(
            f"--states, --inputs: got {len(states)} and {len(inputs)}, expected 1 to 4 states and "
            "1 or 2 inputs"
        )
    path = Path(args.scenario)
    try:
        recording = read_recording(path, states, inputs)
    except FitError as error:
        raise UsageError(str(error)) from None
    try:
        found = fit_recording(recording, violation=violation, confidence=confidence)
    except FitError as error:
        raise Failure(str(error)) from None
    identified, scaled, held_out = found.steps
    promise = (
        f"a step leaves D_c with probability at most {found.violation:.3g}, confidence "
        f"{found.confidence:g}: {found.exceeded} of {held_out} steps held out did"
    )
    origin = (
        f"A, B and D_c by `wyner fit` from {path.name}: states {', '.join(states)}; inputs "
        f"{', '.join(inputs)}.\nUnder the recorded inputs {promise}."
    )
    widths = found.half_widths / WIDER
    text, starts = FirstScenario(
        args.output.stem,
        found.model.A.tolist(),
        found.model.B.tolist(),
        args.period,
        found.bounds.tolist(),
        widths.tolist(),
        origin,
    ).text()
    with writing(f"--output: {args.output}"):
        write_atomically(args.output, text.encode())
    warnings = found.warnings()
    if not starts:
        warnings.append(f"there is no terminal set yet: `wyner design {args.output}` says why")
    if args.json:
        told = {
            "output": str(args.output),
            "A": found.model.A.tolist(),
            "B": found.model.B.tolist(),
            "standard_errors": found.model.errors.tolist(),
            "half_widths": found.half_widths.tolist(),
            "steps": {"identified": identified, "scaled": scaled, "held_out": held_out},
            "exceeded": found.exceeded,
            "violation": found.violation,
            "confidence": found.confidence,
            "warnings": warnings,
        }
        bare = {"violation": STATED, "confidence": STATED}
        print(json.dumps({**told, "no_interval": bare}))
        return DONE
    print(f"A and B from {identified} steps, condition {found.model.condition:.3g}")
    for i, name in enumerate(states):
        row = [*found.model.A[i].tolist(), *found.model.B[i].tolist()]
        terms = (f"{v:+.5g} {of}" for v, of in zip(row, (*states, *inputs), strict=True))
        errors = ", ".join(f"{e:.1g}" for e in found.model.errors[i])
        print(f"  next {name} = {' '.join(terms)}   (standard errors {errors})")
    print("D_c half-widths " + "  ".join(f"{w:.4g}" for w in found.half_widths))
    print(promise)
    for line in warnings:
        print(f"warning: {line}")
    print(f"wrote {args.output}; `wyner design {args.output}` says what the loop carries")
    return DONE


def _fit_plant(args: argparse.Namespace) -> int:
    from controller_service.laws.online import ProgramError
    from controller_service.laws.registry import make_law, synthesise
    from controller_service.sets.design import SynthesisError
    from plant_service.adapters import Operated
    from plant_service.adapters.registry import open_plant
    from protocol.scenario import Scenario, ScenarioError
    from runtime.shipped import scenario_file_of
    from wyner.fit.fitting import fit
    from wyner.fit.identification import FitError
    from wyner.fit.toml import as_toml
    from wyner.simulate.engine import SimulationError

    plan = _plan(args)
    path = scenario_file_of(args.scenario)

    def opened(scenario: Scenario) -> Operated:
        return open_plant(scenario, path.parent)

    try:
        found = fit(
            _tables(path),
            str(path),
            opened,
            lambda s: make_law(s, synthesise(s)),
            plan,
            lambda line: print(f"wyner: {line}", file=sys.stderr),
            path.parent,
        )
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{path}: {error}") from None
    except (FitError, SimulationError) as error:
        raise Failure(str(error)) from None
    c = found.scenario.defender.calibration
    assert c is not None
    N = found.scenario.defender.noise
    what = "D_c" if N is None else "W = D_c + N - A N"
    promise = (
        f"a session of {c.steps} steps leaves {what} with probability at most {c.violation:.3g}, "
        f"confidence {c.confidence:g}: {c.exceeded} of {c.sessions} fresh sessions did"
    )
    if N is not None:
        promise += f"; D_c itself rests on N, {'stated' if plan.noise is None else 'fitted'}"
    head = f"Written by wyner fit, seed {plan.seed}.\n{promise[0].upper()}{promise[1:]}."
    with writing(f"--output: {args.output}"):
        write_atomically(args.output, as_toml(found.tables, head).encode())
    widths = found.scenario.defender.disturbance.half_widths
    assert widths is not None
    if args.json:
        told = {"output": str(args.output), "seed": plan.seed, "half_widths": list(widths)}
        told |= {} if N is None else {"noise": N.model_dump(exclude_none=True)}
        bare = {"violation": STATED, "confidence": STATED}
        print(json.dumps({**told, "calibration": c.model_dump(), "no_interval": bare}))
        return DONE
    print(f"D_c half-widths {' '.join(f'{w:.4g}' for w in widths)}")
    if N is not None and N.half_widths is not None:
        print(f"N half-widths {' '.join(f'{w:.4g}' for w in N.half_widths)}")
    print(promise)
    print(f"wrote {args.output}")
    return DONE


def _names(option: str, text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise UsageError(f"{option}: got {text!r}, expected names of columns, such as a,b,c")
    return names


def _tables(path: Path) -> dict[str, Any]:
    from runtime.files import read_regular
    from runtime.scenario_file import others_than

    if not path.exists():
        raise UsageError(f"{path}: no such file{others_than(str(path))}")
    try:
        return tomllib.loads(read_regular(path).decode())
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"{path}: cannot be read: {reason}") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: not TOML: {error}") from None


def _plan(args: argparse.Namespace) -> "Plan":
    """The checked numbers."""
    from runtime.options import at_least
    from wyner.fit.conformal import rank
    from wyner.fit.fitting import Plan

    for name in ("sessions", "excite_steps", "steps"):
        at_least(f"--{name.replace('_', '-')}", getattr(args, name), 1)
    own = {name: getattr(args, name, None) for name in Plan.__dataclass_fields__}
    given = {name: value for name, value in own.items() if value is not None}
    if args.sessions is not None:
        few = max(1, args.sessions // 5)
        given |= {"calibration": args.sessions, "fresh": args.sessions}
        given |= {"pilot": few, "excite_sessions": few}
    plan = Plan(**given)
    for name in ("amplitude", "violation", "confidence"):
        _check_share(name, getattr(plan, name))
    if args.noise is not None and not 0 < args.noise < float("inf"):
        raise UsageError(f"--noise: got {args.noise:g}, expected above 0")
    try:
        rank(plan.calibration, plan.violation)
    except ValueError as error:
        raise UsageError(f"--sessions: {error}") from None
    return plan


def _check_share(name: str, value: float) -> None:
    if not 0 < value < 1:
        raise UsageError(f"--{name}: got {value:g}, expected between 0 and 1")
