"""``wyner controller``: the controller service."""

import argparse

from protocol.runtime.process import UsageError, freeze_startup, stop_on_signals
from wyner.cli.endpoints import add_endpoint_arguments, endpoints_of, loop_of
from wyner.cli.options import (
    add_message_arguments,
    keep_scenario,
    message_of,
    run_dir_of,
    scenario_of,
)


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the subcommand."""
    parser = subparsers.add_parser("controller", help="run the controller service")
    parser.add_argument("--scenario", default="sustained", metavar="S", help="file or shipped name")
    parser.add_argument("--run-dir", metavar="D", help="where journal and traces lie")
    add_message_arguments(parser)
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")
    add_endpoint_arguments(parser, "controller")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run until a signal comes."""
    from controller_service.laws.base import ProgramError
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.service import ControllerConfig, run_controller
    from controller_service.sets.design import SynthesisError
    from protocol.runtime.bus import TransportError
    from protocol.runtime.zenoh_bus import open_bus
    from wyner.cli.design import progress_bar

    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed: got {args.seed}, expected at least 0")
    scenario = scenario_of(args.scenario)
    try:
        with progress_bar() as progress:
            design = cached_design(scenario, progress)
        law = make_law(scenario, design)
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{scenario.name}: {error}") from None
    config = ControllerConfig(
        scenario=scenario,
        law=law,
        loop=loop_of(args),
        message=message_of(args.message, args.message_file),
        seed=args.seed,
        run_dir=run_dir_of(args.run_dir),
    )
    try:
        with (
            stop_on_signals() as stopping,
            open_bus(endpoints_of(args, "controller", "field")) as field,
            open_bus(endpoints_of(args, "controller", "ops")) as ops,
        ):
            keep_scenario(config.run_dir, args.scenario)
            freeze_startup()
            return run_controller(config, field, ops, stopping)
    except TransportError as error:
        raise UsageError(str(error)) from None
