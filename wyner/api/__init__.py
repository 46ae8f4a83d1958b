"""The library: what a notebook imports, as ``from wyner import ...``.

Load or build a scenario, design it, simulate it, let eavesdroppers hear it, get arrays and data
frames, draw on axes of one's own::

    from wyner import design, eavesdrop, run

    system = design("sustained")
    runs = run(system, steps=1000, runs=20, seed=1, message=b"We sail at dawn.")
    print(runs.rate, runs.messages[0], eavesdrop(runs, ["nearest-centre"]))

Wrong input raises a ValueError (a `WynerError`) with a line for each field, its value and what was
expected.
"""

from controller_service.laws.errors import OutsideError, ProgramError
from controller_service.sets.design import SynthesisError
from plant_service.adapters import PlantAdapter, PlantError, Sample, Stepped
from protocol.errors import WynerError
from protocol.knowledge import Knowledge
from protocol.scenario import Scenario, ScenarioError
from protocol.statistics import Interval
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import LADDER, Belief, Eavesdropper, Guess, KnowledgeError
from wyner.api.drawing import draw_agreement, draw_rate, draw_sets, draw_states
from wyner.api.eavesdropping import TapScore, eavesdrop
from wyner.api.runs import check, report
from wyner.api.simulation import Simulated, rate_against_alpha, run
from wyner.api.systems import System, build, design, load, scenario_names, vary
from wyner.simulate.engine import SimulationError
from wyner.simulate.engine.taps import EavesdropperError

__all__ = [
    "LADDER",
    "Belief",
    "Eavesdropper",
    "EavesdropperError",
    "Guess",
    "Interval",
    "Knowledge",
    "KnowledgeError",
    "OutsideError",
    "PlantAdapter",
    "PlantError",
    "ProgramError",
    "Sample",
    "Scenario",
    "ScenarioError",
    "Simulated",
    "SimulationError",
    "Stepped",
    "SynthesisError",
    "System",
    "TapScore",
    "Transition",
    "WynerError",
    "build",
    "check",
    "design",
    "draw_agreement",
    "draw_rate",
    "draw_sets",
    "draw_states",
    "eavesdrop",
    "load",
    "rate_against_alpha",
    "report",
    "run",
    "scenario_names",
    "vary",
]
