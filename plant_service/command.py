"""``wyner plant``, and ``python -m plant_service``."""

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from runtime.bus_options import add_service_arguments
from runtime.end_service import EndOptions, run_end
from runtime.errors import UsageError
from runtime.logs import logger
from runtime.options import option, picked

if TYPE_CHECKING:
    from protocol.scenario import Scenario
    from runtime.fleet import FleetLoop


@dataclass(frozen=True, kw_only=True)
class PlantOptions(EndOptions):
    """The service's options."""

    steps: int | None = option("stop at step N", "N", least=1)
    clear_safe: bool = option("run a plant again that is in its safe state", default=False)
    attack: str | None = option(
        "attack this plant from a step on, in place of the scenario's [attack]", "KIND@STEP"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    parser.description = (
        "Run the plant: simulate or drive it, toss its coin, apply what is offered, recover "
        "the message."
    )
    add_service_arguments(parser, "plant", PlantOptions)


def run(args: argparse.Namespace) -> int:
    """Run until the steps are made or a signal comes.

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    from plant_service.adapters.registry import is_model
    from plant_service.service import PlantConfig, add_plant
    from runtime.scenario_file import attack_option

    options = picked(PlantOptions, vars(args))
    if options.fleet is not None and options.steps is not None:
        raise UsageError("--steps: a fleet runs until it is stopped")

    def configure(common: dict[str, Any], _loop: "FleetLoop") -> PlantConfig:
        scenario: Scenario = common["scenario"]
        if options.fleet is not None and not is_model(scenario):
            raise UsageError(f"plant.kind: got {scenario.plant.kind!r}, expected linear in a fleet")
        attack = attack_option(options.attack, scenario.attack, options.steps)
        return PlantConfig(
            **common, steps=options.steps, attack=attack, clear_safe=options.clear_safe
        )

    return run_end(options, logger("plant"), None, configure, add_plant)
