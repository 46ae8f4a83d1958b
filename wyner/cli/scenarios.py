"""``wyner scenarios``: what is shipped."""

import argparse
import json
from pathlib import Path

from runtime.errors import DONE, Failure, UsageError
from runtime.files import PUBLIC_FILE, write_atomically


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "List the scenarios that can be named instead of a file. With --knowledge, write as JSON "
        "what the paper's eavesdropper knows of one: f_c and D_e, and neither D_c nor alpha. A tap "
        "on a machine of its own needs this file and no scenario (wyner tap --knowledge FILE)."
    )
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="file or shipped name")
    parser.add_argument(
        "--knowledge",
        nargs="?",
        const="",
        metavar="FILE",
        help="write what the eavesdropper of SCENARIO is told (default: standard output)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print a line a scenario, or write one's public part."""
    if args.knowledge is not None:
        return _write_knowledge(args.scenario, args.knowledge)
    if args.scenario is not None:
        raise UsageError("SCENARIO: expected --knowledge [FILE] with it")
    from runtime.scenario_file import load_scenario
    from runtime.shipped import SCENARIOS

    found = [load_scenario(path) for path in sorted(SCENARIOS.glob("*.toml"))]
    if args.json:
        about = {
            s.name: {
                "description": s.description,
                "states": s.n,
                "inputs": s.m,
                "candidates": s.secrecy.candidates,
                "law": s.control.law,
                "period_s": s.plant.period_s,
                "source": s.source,
                "file": str(SCENARIOS / f"{s.name}.toml"),
            }
            for s in found
        }
        print(json.dumps(about))
        return DONE
    wide = max(len(s.name) for s in found)
    for s in found:
        size = (
            f"n {s.n}, m {s.m}, M {s.secrecy.candidates}, {s.plant.period_s:g} s, {s.control.law}"
        )
        print(f"{s.name:<{wide}}  {size:<34}  {s.description}")
    print(f"\nThe files are in {SCENARIOS}; `wyner new NAME` writes one of your own.")
    return DONE


def _write_knowledge(scenario: str | None, file: str) -> int:
    from runtime.scenario_file import scenario_of

    if scenario is None:
        raise UsageError("--knowledge: expected SCENARIO as well")
    text = scenario_of(scenario).knowledge().model_dump_json(indent=2) + "\n"
    if not file:
        print(text, end="")
        return DONE
    try:
        write_atomically(Path(file), text.encode(), PUBLIC_FILE)
    except OSError as error:
        raise Failure(f"--knowledge: {file}: cannot be written: {error.strerror}") from None
    return DONE
