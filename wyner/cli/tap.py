"""``wyner tap``: the tap service, which here may derive what it knows from a scenario."""

import argparse

from runtime.errors import UsageError
from runtime.options import picked
from tap_service.command import (
    GivenKnowledge,
    TapOptions,
    add_options,
    knowledge_in,
    run_with_knowledge,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Hear what passes between controller and plant, record it, and let eavesdroppers guess. "
        "What they may know is derived from a scenario, or read from a file."
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--scenario", metavar="S", help="derive what the tap knows from a scenario")
    source.add_argument("--knowledge", metavar="FILE", help="what the tap knows, as JSON")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the service until it is told to stop."""
    options = picked(TapOptions, vars(args))
    if args.knowledge is not None:
        return run_with_knowledge(options, knowledge_in(args.knowledge))
    if args.scenario is None and args.fleet is None:
        raise UsageError("--scenario, --knowledge or --fleet: expected one of them")
    from runtime.scenario_file import scenario_of

    def knowledge_of(name: str) -> GivenKnowledge:
        scenario = scenario_of(name)
        return GivenKnowledge(
            scenario.knowledge(),
            scenario.oracle_knowledge(),
            view=scenario.tap.model_dump(exclude={"eavesdroppers"}),
            names=scenario.tap.eavesdroppers,
            where=f"{name}: tap.eavesdroppers: ",
        )

    told = None if args.scenario is None else knowledge_of(args.scenario)
    return run_with_knowledge(options, told, lambda loop: knowledge_of(loop.scenario))
