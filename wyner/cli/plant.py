"""``wyner plant``: the plant service."""

import argparse

from protocol.runtime.process import UsageError, freeze_startup, stop_on_signals
from wyner.cli.endpoints import add_endpoint_arguments, endpoints_of, loop_of
from wyner.cli.options import keep_scenario, pace_of, run_dir_of, scenario_of


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the subcommand."""
    parser = subparsers.add_parser("plant", help="run the plant service with its simulation")
    parser.add_argument("--scenario", default="sustained", metavar="S", help="file or shipped name")
    parser.add_argument("--run-dir", metavar="D", help="where journal and traces lie")
    parser.add_argument(
        "--pace", default="realtime", metavar="P", help="realtime, xN, or fast (lock-step)"
    )
    parser.add_argument("--steps", type=int, metavar="N", help="stop at step N")
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")
    add_endpoint_arguments(parser, "plant")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run until the steps are made or a signal comes."""
    from plant_service.service import PlantConfig, run_plant
    from protocol.runtime.bus import TransportError
    from protocol.runtime.zenoh_bus import open_bus

    if args.steps is not None and args.steps < 1:
        raise UsageError(f"--steps: got {args.steps}, expected at least 1")
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed: got {args.seed}, expected at least 0")
    config = PlantConfig(
        scenario=scenario_of(args.scenario),
        loop=loop_of(args),
        pace=pace_of(args.pace),
        steps=args.steps,
        seed=args.seed,
        run_dir=run_dir_of(args.run_dir),
    )
    try:
        with (
            stop_on_signals() as stopping,
            open_bus(endpoints_of(args, "plant", "field")) as field,
            open_bus(endpoints_of(args, "plant", "ops")) as ops,
        ):
            keep_scenario(config.run_dir, args.scenario)
            freeze_startup()
            return run_plant(config, field, ops, stopping)
    except TransportError as error:
        raise UsageError(str(error)) from None
