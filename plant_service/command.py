"""``wyner plant``, and ``python -m plant_service``."""

import argparse
from pathlib import Path

from runtime.bus_options import add_end_arguments, buses_of, fleet_of, loop_of
from runtime.errors import DONE, UsageError
from runtime.options import at_least, checked, pace_of, run_dir_of
from runtime.recording import Bounds
from runtime.run_folder import PLANT_SAFE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    parser.add_argument("--scenario", default="sustained", metavar="S", help="file or shipped name")
    parser.add_argument("--run-dir", metavar="D", help="where journal and traces lie")
    parser.add_argument(
        "--pace", default="realtime", metavar="P", help="realtime, xN, or fast (lock-step)"
    )
    parser.add_argument("--steps", type=int, metavar="N", help="stop at step N")
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")
    parser.add_argument(
        "--plant-folder",
        metavar="D",
        help="where the files are that [plant] names (default: the scenario's own folder)",
    )
    parser.add_argument(
        "--clear-safe",
        action="store_true",
        help="let a plant run again that was sent to its safe state",
    )
    parser.add_argument(
        "--attack",
        metavar="KIND@STEP",
        help="attack this plant from a step on, in place of the scenario's [attack]",
    )
    parser.add_argument(
        "--secret",
        metavar="F",
        help="sign key blocks by this file, as `wyner certs --secret` writes it",
    )
    add_end_arguments(parser, "plant")


def run(args: argparse.Namespace) -> int:
    """Run until the steps are made or a signal comes."""
    from plant_service.service import PlantConfig, PlantService, run_plants
    from runtime.scenario_file import attack_option, keep_scenario, scenario_of
    from runtime.shipped import scenario_file_of

    at_least("--steps", args.steps, 1)
    at_least("--seed", args.seed, 0)
    bounds = checked(Bounds, part_bytes=args.part_bytes, total_bytes=args.total_bytes)
    fleet = fleet_of(args)
    if fleet is not None and not args.check:
        folder, pace = run_dir_of(args.run_dir), pace_of(args.pace)
        if args.steps is not None:
            raise UsageError("--steps: a fleet runs until it is stopped")
        with buses_of(args, "plant") as (stopping, field, ops):
            return run_plants(fleet, folder, pace, bounds, field, ops, stopping)
    scenario, pace = scenario_of(args.scenario), pace_of(args.pace)
    attack = attack_option(args.attack, scenario.attack, args.steps)
    if args.check:
        return DONE
    config = PlantConfig(
        scenario=scenario,
        loop=loop_of(args),
        pace=pace,
        steps=args.steps,
        attack=attack,
        seed=args.seed,
        bounds=bounds,
        secret=None if args.secret is None else Path(args.secret),
        run_dir=run_dir_of(args.run_dir),
        folder=scenario_file_of(args.scenario).parent
        if args.plant_folder is None
        else Path(args.plant_folder),
    )
    if args.clear_safe:
        (config.run_dir / PLANT_SAFE).unlink(missing_ok=True)
    with buses_of(args, "plant") as (stopping, field, ops):
        keep_scenario(config.run_dir, args.scenario)
        return PlantService(config, field, ops, stopping).run()
