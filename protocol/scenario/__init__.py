"""Scenario files: a plant, its sets, its control law and what the defender shares, in TOML.

A table is a file of this package; one whose fields depend on a kind is read by that kind's model
(:mod:`protocol.scenario.kinds`). The paper's numbers stand once, in ``paper.toml``. Everything here
is the defender's knowledge; an eavesdropper is handed a :class:`protocol.knowledge.Knowledge` made
from it, and never this.
"""

from protocol.scenario.attack import AttackTable, attack_of
from protocol.scenario.control import Control, Cost, Performance, Regulator
from protocol.scenario.defence import DefenceTable
from protocol.scenario.defender import Calibration, Defender
from protocol.scenario.keys import Keys
from protocol.scenario.kinds import LAWS
from protocol.scenario.link import Link
from protocol.scenario.network import ChannelTable, Network
from protocol.scenario.noise import NoiseSet, SensorNoise
from protocol.scenario.parts import ScenarioTable
from protocol.scenario.plant import Disturbance, OperatingPointTable, PlantTable
from protocol.scenario.plants import PLANTS
from protocol.scenario.reading import (
    ScenarioError,
    parse_scenario,
    with_fields,
)
from protocol.scenario.secrecy import Secrecy
from protocol.scenario.sets import ConvexSet
from protocol.scenario.system import DESIGN_VERSION, RULES_VERSION, Scenario
from protocol.scenario.tap import TapView

__all__ = [
    "DESIGN_VERSION",
    "LAWS",
    "PLANTS",
    "RULES_VERSION",
    "AttackTable",
    "Calibration",
    "ChannelTable",
    "Control",
    "ConvexSet",
    "Cost",
    "DefenceTable",
    "Defender",
    "Disturbance",
    "Keys",
    "Link",
    "Network",
    "NoiseSet",
    "OperatingPointTable",
    "Performance",
    "PlantTable",
    "Regulator",
    "Scenario",
    "ScenarioError",
    "ScenarioTable",
    "Secrecy",
    "SensorNoise",
    "TapView",
    "attack_of",
    "parse_scenario",
    "with_fields",
]
