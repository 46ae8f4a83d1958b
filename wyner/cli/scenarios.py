"""``wyner scenarios``: what is shipped."""

import argparse
import json

from runtime.errors import DONE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = "List the scenarios that can be named instead of a file."
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print a line a scenario."""
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
