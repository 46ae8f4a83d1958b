"""One run of a shipped scenario by the engine."""

from runtime.scenario_file import scenario_of
from runtime.shipped import SCENARIOS
from studies.listeners import one_run
from wyner.simulate.engine import Runs, Transfer

SEED = 43


def shipped_run(name: str, steps: int, run: int) -> tuple[Runs, Transfer]:
    """A run with its record, and what it carried of a short message."""
    scenario = scenario_of(name)
    return one_run(scenario, run, seed=SEED, steps=steps, payload=b"Sail at dawn", folder=SCENARIOS)
