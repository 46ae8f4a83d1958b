"""``wyner controller``, and ``python -m controller_service``."""

import argparse
from pathlib import Path

from protocol.runtime.endpoints import add_endpoint_arguments, endpoints_of, loop_of
from protocol.runtime.options import add_message_arguments, at_least, message_of, run_dir_of
from protocol.runtime.process import UsageError, freeze_startup, stop_on_signals


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    parser.add_argument("--scenario", default="sustained", metavar="S", help="file or shipped name")
    parser.add_argument("--run-dir", metavar="D", help="where journal and traces lie")
    add_message_arguments(parser)
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")
    parser.add_argument(
        "--secret", metavar="F", help="sign key blocks by this file, as `wyner secret` writes it"
    )
    add_endpoint_arguments(parser, "controller")


def run(args: argparse.Namespace) -> int:
    """Run until a signal comes."""
    from controller_service.laws.base import ProgramError
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.progress import shown_progress
    from controller_service.service import ControllerConfig, run_controller
    from controller_service.sets.design import SynthesisError
    from protocol.runtime.bus import TransportError
    from protocol.runtime.zenoh_bus import open_bus
    from protocol.scenario.files import keep_scenario, scenario_of

    at_least("--seed", args.seed, 0)
    scenario = scenario_of(args.scenario)
    try:
        with shown_progress() as progress:
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
        secret=None if args.secret is None else Path(args.secret),
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
