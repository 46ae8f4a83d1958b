"""``wyner fit``: a model and a D_c, with a certificate, from a plant's own readings."""

import argparse
import json
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.statistics import STATED
from runtime.errors import DONE, Failure, UsageError
from runtime.files import write_atomically

if TYPE_CHECKING:
    from wyner.fit.fitting import Plan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Run the plant of SCENARIO: excite it, identify A and B where the file has "
        "none, scale D_c by whole sessions under the law until it stands still, freeze it, and "
        "count the fresh sessions that leave it. Write the scenario with the certificate."
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="a TOML file or a shipped name")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    parser.add_argument("--json", action="store_true", help="one object on standard output")
    numbers: tuple[tuple[str, float, str], ...] = (
        ("--excite-sessions", 20, "sessions with random inputs"),
        ("--excite-steps", 100, "steps of each; few for an unstable plant without a stated gain"),
        ("--pilot", 20, "sessions that give D_c its shape"),
        ("--calibration", 100, "sessions that scale D_c"),
        ("--fresh", 100, "sessions that certify it"),
        ("--steps", 200, "steps of a session under the law"),
        ("--seed", 1, "seed of excitation, coins and disturbance"),
        ("--amplitude", 0.3, "of the random inputs, as a share of U"),
        ("--violation", 0.05, "share of sessions that may leave D_c, for the calibration"),
        ("--confidence", 0.999, "of the certificate"),
    )
    for option, default, text in numbers:
        kind, metavar = (int, "N") if isinstance(default, int) else (float, "P")
        told = f"{text} ({default})"
        parser.add_argument(option, type=kind, default=default, metavar=metavar, help=told)

    parser.add_argument(
        "--noise",
        type=float,
        metavar="K",
        help="take the sensors' noise N from the readings: K standard deviations of it; "
        "else defender.noise counts as stated",
    )


def run(args: argparse.Namespace) -> int:
    """Fit, write, tell."""
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
    if args.output.is_dir() or not args.output.parent.is_dir():
        raise UsageError(f"--output: got {str(args.output)!r}, expected a file in a folder")
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
    try:
        write_atomically(args.output, as_toml(found.tables, head).encode())
    except OSError as error:
        raise UsageError(f"--output: {args.output}: cannot be written: {error.strerror}") from None
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
        raise UsageError(
            f"{path}: not TOML: {error}; expected a scenario: fit runs its plant, and reads no "
            "recordings"
        ) from None


def _plan(args: argparse.Namespace) -> "Plan":
    """The checked numbers."""
    from runtime.options import at_least
    from wyner.fit.conformal import rank
    from wyner.fit.fitting import Plan

    for name in ("excite_sessions", "excite_steps", "pilot", "calibration", "fresh", "steps"):
        at_least(f"--{name.replace('_', '-')}", getattr(args, name), 1)
    for name in ("amplitude", "violation", "confidence"):
        if not 0 < getattr(args, name) < 1:
            raise UsageError(f"--{name}: got {getattr(args, name):g}, expected between 0 and 1")
    if args.noise is not None and not 0 < args.noise < float("inf"):
        raise UsageError(f"--noise: got {args.noise:g}, expected above 0")
    try:
        rank(args.calibration, args.violation)
    except ValueError as error:
        raise UsageError(f"--calibration: {error}") from None
    fields = Plan.__dataclass_fields__
    return Plan(**{name: getattr(args, name) for name in fields})
