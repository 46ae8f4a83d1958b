"""``wyner tap``: the tap service, which here may derive what it knows from a scenario."""

import argparse

import tap_service.command
from runtime.errors import UsageError
from runtime.fleet import FleetLoop
from runtime.options import picked
from tap_service.command import GivenKnowledge, TapOptions, run_with_knowledge


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Listen to the messages between controller and plant, record them, and run eavesdroppers "
        "on them. What these know of the plant is derived from a scenario, or read from a file."
    )
    tap_service.command.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the service until it is told to stop."""
    options = picked(TapOptions, vars(args))
    if options.knowledge is not None:
        return tap_service.command.run(args)
    if options.scenario is None and (options.fleet is None or options.fleet.isdecimal()):
        raise UsageError("--scenario, --knowledge or a file of --fleet: expected one of them")
    from runtime.scenario_file import scenario_of

    def knowledge_of(loop: FleetLoop) -> GivenKnowledge:
        scenario = scenario_of(loop.scenario)
        return GivenKnowledge(
            scenario.knowledge(),
            scenario.oracle_knowledge(),
            view=scenario.tap.model_dump(exclude={"eavesdroppers"}),
            names=scenario.tap.eavesdroppers,
            where=f"{loop.scenario}: tap.eavesdroppers: ",
        )

    return run_with_knowledge(options, knowledge_of)
