"""``wyner fit``: a model and a D_c, from a recording or from a plant that is run for it."""

import argparse
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Final

from runtime import options
from runtime.errors import DONE, Failure, UsageError, writing
from runtime.files import write_atomically
from wyner.cli.results import add_json, show
from wyner.fit.plan import Plan

if TYPE_CHECKING:
    from wyner.fit.written import Written


RECORDED_VIOLATION: Final = 0.01
"""Share of recorded steps that may leave D_c, for its scale."""

VIOLATION: Final = 0.05
"""Share of sessions that may, where a plant is run."""

PLAN: Final = [one.name for one in fields(Plan)]
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
    add_json(parser)
    options.add_arguments(parser, Plan)
    parser.set_defaults(**dict.fromkeys(PLAN))  # a recording is refused with any of them
    parser.add_argument(
        "--violation",
        type=float,
        metavar="P",
        help="share of sessions (0.05) or of recorded steps (0.01) that may leave D_c",
    )


def run(args: argparse.Namespace) -> int:
    """Fit, write the scenario, print what it rests on."""
    if args.output.is_dir() or not args.output.parent.is_dir():
        raise UsageError(f"--output: got {str(args.output)!r}, expected a file in a folder")
    recorded = (args.states, args.inputs, args.period) != (None, None, None)
    if not recorded and Path(args.scenario).suffix.lower() in (".csv", ".mat"):
        raise UsageError(
            f"{args.scenario}: a recording wants --states a,b and --inputs u, its columns, and "
            "--period S"
        )
    found = _fit_recording(args) if recorded else _fit_plant(args)
    with writing(f"--output: {args.output}"):
        write_atomically(args.output, found.text.encode())
    show(found, args)
    return DONE


def _fit_recording(args: argparse.Namespace) -> "Written":
    from protocol.scenario.reading import LARGEST_NUMBER
    from wyner.fit.first_scenario import HORIZONS
    from wyner.fit.identification import FitError
    from wyner.fit.recording import fit_recording, read_recording
    from wyner.fit.written import from_recording

    if None in (args.states, args.inputs, args.period):
        raise UsageError("expected --states, --inputs and --period together")
    if not 0 < args.period <= LARGEST_NUMBER:
        raise UsageError(f"--period: got {args.period:g}, expected more than 0")
    for name in PLAN:
        if getattr(args, name) is not None:
            option = name.replace("_", "-")
            raise UsageError(f"--{option}: is for a plant that is run, and not for a recording")
    violation = RECORDED_VIOLATION if args.violation is None else args.violation
    _check_share("violation", violation)
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
        found = fit_recording(recording, violation)
    except FitError as error:
        raise Failure(str(error)) from None
    return from_recording(recording, found, path, args.output, args.period)


def _fit_plant(args: argparse.Namespace) -> "Written":
    from controller_service.laws.errors import ProgramError
    from controller_service.sets.design import SynthesisError
    from runtime.files import read_toml
    from runtime.scenario_file import others_than
    from runtime.shipped import scenario_file_of
    from wyner.fit.conformal import rank
    from wyner.fit.fitting import fit
    from wyner.fit.identification import FitError
    from wyner.fit.written import from_plant
    from wyner.simulate.engine import SimulationError

    plan = options.picked(Plan, vars(args))
    violation = VIOLATION if args.violation is None else args.violation
    _check_share("amplitude", plan.amplitude)
    _check_share("violation", violation)
    try:
        rank(plan.sessions, violation)
    except ValueError as error:
        raise UsageError(f"--sessions: {error}") from None
    path = scenario_file_of(args.scenario)
    if not path.exists():
        raise UsageError(f"{path}: no such file{others_than(str(path))}")
    try:
        tables, scenario = fit(read_toml(path), path, plan, violation)
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{path}: {error}") from None
    except (FitError, SimulationError) as error:
        raise Failure(str(error)) from None
    return from_plant(tables, scenario, args.output, plan.seed)


def _names(option: str, text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise UsageError(f"{option}: got {text!r}, expected names of columns, such as a,b,c")
    return names


def _check_share(name: str, value: float) -> None:
    if not 0 < value < 1:
        raise UsageError(f"--{name}: got {value:g}, expected between 0 and 1")
