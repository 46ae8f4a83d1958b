"""``wyner controller``, and ``python -m controller_service``."""

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from runtime.bus_options import (
    ServiceOptions,
    add_service_arguments,
    buses_of,
    check_addresses,
    fleet_of,
    loop_of,
)
from runtime.errors import UsageError
from runtime.options import (
    MessageOptions,
    checked,
    fine,
    folder_of,
    message_of,
    option,
    pace_of,
    picked,
    run_dir_of,
)
from runtime.recording import Bounds

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from protocol.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class ControllerOptions(MessageOptions, ServiceOptions):
    """The service's options."""

    scenario: str = option("file or shipped name", "S", "sustained")
    pace: str = option(
        "pace of the plant, which sets the clock of network delays (default: realtime)",
        "P",
        "realtime",
    )
    clear_alarm: bool = option("offer inputs again after an alarm has stopped them", default=False)
    folder: str | None = option(
        "folder of the files that the scenario names (default: the scenario's own)", "D"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    parser.description = (
        "Run the controller: offer inputs for each state that the plant reports, and send the "
        "messages that are handed to it."
    )
    add_service_arguments(parser, "controller", ControllerOptions)


def run(args: argparse.Namespace) -> int:
    """Run until a signal comes."""
    return run_controller(picked(ControllerOptions, vars(args)))


def run_controller(options: ControllerOptions) -> int:
    """Run until a signal comes.

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    from controller_service.service import ControllerConfig, ControllerService, run_controllers
    from runtime.fleet_host import check_loops
    from runtime.scenario_file import keep_scenario, scenario_of
    from runtime.shipped import scenario_file_of

    check_addresses(options, "controller")
    bounds = checked(Bounds, total_bytes=options.total_bytes)
    message = message_of(options.message)
    fleet = fleet_of(options, message)
    if fleet is not None:
        pace = pace_of(options.pace)
        if options.check:
            check_loops(fleet)
            return fine(f"{len(fleet.loops)} loops")
        folder = run_dir_of(options.run_dir)
        with buses_of(options, "controller") as (stopping, field, management):
            return run_controllers(
                fleet, folder, designed, bounds, pace, field, management, stopping
            )
    scenario, pace = scenario_of(options.scenario), pace_of(options.pace)
    folder = folder_of("--folder", options.folder, scenario_file_of(options.scenario).parent)
    if options.check:
        return fine(f"scenario {scenario.name}")
    config = ControllerConfig(
        scenario=scenario,
        law=designed(scenario),
        loop=loop_of(options.loop),
        message=message,
        pace=pace,
        seed=options.seed,
        bounds=bounds,
        clear_alarm=options.clear_alarm,
        run_dir=run_dir_of(options.run_dir),
        folder=folder,
    )
    with buses_of(options, "controller") as (stopping, field, management):
        keep_scenario(config.run_dir, options.scenario)
        return ControllerService(config, field, management, stopping).run()


def designed(scenario: "Scenario") -> "CandidateLaw":
    """The scenario's law on its design, which is computed where the cache has none; shows progress.

    Raises
    ------
    UsageError
        When there is no design, or no law on it.
    """
    from controller_service.laws.online import ProgramError
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.progress import shown_progress
    from controller_service.sets.design import SynthesisError

    try:
        with shown_progress() as progress:
            design = cached_design(scenario, progress)
        return make_law(scenario, design)
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{scenario.name}: {error}") from None
