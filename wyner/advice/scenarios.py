"""The scenarios that are shipped, as a list."""

from dataclasses import dataclass
from typing import Any

from protocol.scenario import Scenario
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS


@dataclass(frozen=True)
class ScenarioList:
    """Scenarios, with what tells them apart."""

    scenarios: tuple[Scenario, ...]

    def to_json(self) -> dict[str, Any]:
        """By name: sizes, law, period, origin and file."""
        return {
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
            for s in self.scenarios
        }

    def __str__(self) -> str:
        """Two lines for each."""
        lines = []
        for s in self.scenarios:
            size = f"n {s.n}, m {s.m}, M {s.secrecy.candidates}, {s.plant.period_s:g} s"
            lines += [f"{s.name}: {size}, law {s.control.law}", f"  {s.description}"]
        end = f"The files are in {SCENARIOS}; `wyner new NAME` writes one of your own."
        return "\n".join([*lines, "", end])


def shipped_scenarios() -> ScenarioList:
    """Those in `runtime/scenarios`, by name."""
    return ScenarioList(tuple(map(load_scenario, sorted(SCENARIOS.glob("*.toml")))))
