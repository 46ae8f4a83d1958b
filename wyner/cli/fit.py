"""``wyner fit``: a model and a D_c, from a recording or from a plant that is run for it."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from runtime.errors import DONE, Failure, UsageError, writing
from runtime.files import write_atomically
from wyner.cli.results import add_json, show

if TYPE_CHECKING:
    from wyner.fit.fitting import Plan
    from wyner.fit.written import FromPlant, FromRecording


RECORDED_VIOLATION: Final = 0.01
"""Share of recorded steps that may leave D_c, for its scale."""

OF_A_PLANT: Final = (
    "sessions",
    "excite_steps",
    "steps",
    "seed",
    "amplitude",
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
    add_json(parser)
    numbers: tuple[tuple[str, float, str], ...] = (
        ("--sessions", 100, "sessions that scale D_c, and as many that certify it"),
        ("--steps", 200, "steps of a session under the law"),
        ("--excite-steps", 100, "steps of one with random inputs; few for an unstable plant"),
        ("--seed", 1, "seed of excitation, coins and disturbance"),
        ("--amplitude", 0.3, "of the random inputs, as a share of U"),
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


def _fit_recording(args: argparse.Namespace) -> "FromRecording":
    from protocol.scenario.reading import LARGEST_NUMBER
    from wyner.fit.first_scenario import HORIZONS
    from wyner.fit.identification import FitError
    from wyner.fit.recording import fit_recording, read_recording
    from wyner.fit.written import FromRecording

    if None in (args.states, args.inputs, args.period):
        raise UsageError("expected --states, --inputs and --period together")
    if not 0 < args.period <= LARGEST_NUMBER:
        raise UsageError(f"--period: got {args.period:g}, expected more than 0")
    for name in OF_A_PLANT:
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
        found = fit_recording(recording, violation=violation)
    except FitError as error:
        raise Failure(str(error)) from None
    return FromRecording(path, args.output, args.period, recording, found)


def _fit_plant(args: argparse.Namespace) -> "FromPlant":
    from controller_service.laws.base import CandidateLaw
    from controller_service.laws.errors import ProgramError
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.progress import shown_progress
    from controller_service.sets.design import SynthesisError
    from plant_service.adapters import Operated
    from plant_service.adapters.registry import open_plant
    from protocol.scenario import Scenario
    from runtime.shipped import scenario_file_of
    from wyner.fit.fitting import fit
    from wyner.fit.identification import FitError
    from wyner.fit.written import FromPlant
    from wyner.simulate.engine import SimulationError

    plan = _plan(args)
    path = scenario_file_of(args.scenario)

    def opened(scenario: Scenario) -> Operated:
        return open_plant(scenario, path.parent)

    def law_of(scenario: Scenario) -> CandidateLaw:
        # The same fit again, as after Ctrl-C, makes the same sets and finds them in the cache.
        with shown_progress() as progress:
            return make_law(scenario, cached_design(scenario, progress))

    try:
        found = fit(
            _tables(path),
            str(path),
            opened,
            law_of,
            plan,
            lambda line: print(f"wyner: {line}", file=sys.stderr),
            path.parent,
        )
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{path}: {error}") from None
    except (FitError, SimulationError) as error:
        raise Failure(str(error)) from None
    return FromPlant(args.output, found, plan)


def _names(option: str, text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise UsageError(f"{option}: got {text!r}, expected names of columns, such as a,b,c")
    return names


def _tables(path: Path) -> dict[str, Any]:
    from runtime.files import read_toml
    from runtime.scenario_file import others_than

    if not path.exists():
        raise UsageError(f"{path}: no such file{others_than(str(path))}")
    return read_toml(path)


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
    for name in ("amplitude", "violation"):
        _check_share(name, getattr(plan, name))
    try:
        rank(plan.calibration, plan.violation)
    except ValueError as error:
        raise UsageError(f"--sessions: {error}") from None
    return plan


def _check_share(name: str, value: float) -> None:
    if not 0 < value < 1:
        raise UsageError(f"--{name}: got {value:g}, expected between 0 and 1")
