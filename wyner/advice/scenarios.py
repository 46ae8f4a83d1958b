"""The scenarios that are shipped, as a list."""

from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from wyner.printout import Printout


def shipped_scenarios() -> Printout:
    """Those in `runtime/scenarios`, by name, with what tells them apart: two lines for each."""
    figures, lines = {}, []
    for s in map(load_scenario, sorted(SCENARIOS.glob("*.toml"))):
        figures[s.name] = {
            "description": s.description,
            "states": s.n,
            "inputs": s.m,
            "candidates": s.secrecy.candidates,
            "law": s.control.law,
            "period_s": s.plant.period_s,
            "source": s.source,
            "file": str(SCENARIOS / f"{s.name}.toml"),
        }
        size = f"n {s.n}, m {s.m}, M {s.secrecy.candidates}, {s.plant.period_s:g} s"
        lines += [f"{s.name}: {size}, law {s.control.law}", f"  {s.description}"]
    end = f"The files are in {SCENARIOS}; `wyner new NAME` writes one of your own."
    return Printout(figures, [*lines, "", end])
