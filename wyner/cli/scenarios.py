"""The scenarios that are shipped, and what an eavesdropper is told of one."""

import json
from pathlib import Path

from runtime.errors import DONE, writing
from runtime.files import PUBLIC_FILE, write_atomically
from runtime.scenario_file import load_scenario, scenario_of
from runtime.shipped import SCENARIOS


def list_scenarios(*, as_json: bool) -> int:
    """Print a line for each shipped scenario, or one JSON object; return the exit code."""
    found = [load_scenario(path) for path in sorted(SCENARIOS.glob("*.toml"))]
    if as_json:
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


def write_knowledge(scenario: str, file: str) -> int:
    """Write as JSON what Eve is told of a scenario; to standard output where ``file`` is empty."""
    text = scenario_of(scenario).knowledge().model_dump_json(indent=2) + "\n"
    if not file:
        print(text, end="")
        return DONE
    with writing(f"--knowledge: {file}"):
        write_atomically(Path(file), text.encode(), PUBLIC_FILE)
    return DONE
