"""``wyner plant``, and ``python -m plant_service``."""

import argparse
from dataclasses import dataclass

from runtime.bus_options import (
    ServiceOptions,
    add_service_arguments,
    buses_of,
    check_addresses,
    fleet_of,
    loop_of,
)
from runtime.errors import UsageError
from runtime.options import checked, fine, folder_of, option, pace_of, picked, run_dir_of
from runtime.recording import Bounds
from runtime.run_folder import PLANT_SAFE


@dataclass(frozen=True, kw_only=True)
class PlantOptions(ServiceOptions):
    """The service's options."""

    scenario: str = option("file or shipped name", "S", "sustained")
    pace: str = option("realtime, xN, or fast (lock-step)", "P", "realtime")
    steps: int | None = option("stop at step N", "N", least=1)
    folder: str | None = option(
        "folder of the files that the scenario names (default: the scenario's own)", "D"
    )
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
    """Run until the steps are made or a signal comes."""
    return run_plant(picked(PlantOptions, vars(args)))


def run_plant(options: PlantOptions) -> int:
    """Run until the steps are made or a signal comes.

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    from plant_service.service import PlantConfig, PlantService, run_plants
    from runtime.fleet_host import check_loops
    from runtime.scenario_file import attack_option, keep_scenario, scenario_of
    from runtime.shipped import scenario_file_of

    check_addresses(options, "plant")
    bounds = checked(Bounds, total_bytes=options.total_bytes)
    fleet = fleet_of(options)
    if fleet is not None:
        pace = pace_of(options.pace)
        if options.steps is not None:
            raise UsageError("--steps: a fleet runs until it is stopped")
        if options.check:
            check_loops(fleet)
            return fine(f"{len(fleet.loops)} loops")
        folder = run_dir_of(options.run_dir)
        with buses_of(options, "plant") as (stopping, field, management):
            return run_plants(fleet, folder, pace, bounds, field, management, stopping)
    scenario, pace = scenario_of(options.scenario), pace_of(options.pace)
    attack = attack_option(options.attack, scenario.attack, options.steps)
    folder = folder_of("--folder", options.folder, scenario_file_of(options.scenario).parent)
    if options.check:
        return fine(f"scenario {scenario.name}")
    config = PlantConfig(
        scenario=scenario,
        loop=loop_of(options.loop),
        pace=pace,
        steps=options.steps,
        attack=attack,
        seed=options.seed,
        bounds=bounds,
        run_dir=run_dir_of(options.run_dir),
        folder=folder,
    )
    if options.clear_safe:
        (config.run_dir / PLANT_SAFE).unlink(missing_ok=True)
    with buses_of(options, "plant") as (stopping, field, management):
        keep_scenario(config.run_dir, options.scenario)
        return PlantService(config, field, management, stopping).run()
