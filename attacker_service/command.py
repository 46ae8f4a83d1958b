"""``python -m attacker_service``: an attack on the field bus, as ``wyner up`` starts it."""

import argparse
from dataclasses import dataclass

from runtime.bus_options import BusOptions, loop_of
from runtime.errors import DONE, UsageError
from runtime.options import picked


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    from protocol.topics import DEFAULT_LOOP

    parser.add_argument("--scenario", required=True, metavar="S", help="file or shipped name")
    parser.add_argument("--attack", metavar="KIND@STEP", help="in place of the scenario's [attack]")
    parser.add_argument("--loop", default=DEFAULT_LOOP, metavar="ID", help="id of the control loop")
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")
    for side in ("plant", "controller"):
        parser.add_argument(
            f"--{side}-side",
            required=True,
            metavar="ENDPOINT",
            help=f"listen there for the {side}, such as tcp/127.0.0.1:7461",
        )


@dataclass(frozen=True, kw_only=True)
class AttackerOptions(BusOptions):
    """The service's options."""

    scenario: str
    attack: str | None = None
    seed: int | None = None
    plant_side: str
    controller_side: str


def run(args: argparse.Namespace) -> int:
    """Pass messages on until a signal comes."""
    return run_attacker(picked(AttackerOptions, vars(args)))


def run_attacker(options: AttackerOptions) -> int:
    """Pass messages on until a signal comes.

    Raises
    ------
    UsageError
        When an option's value is wrong, or no such attack is at the bus.
    """
    from attacker_service.attacker import Attacker
    from attacker_service.relay import Relay
    from runtime.bus import TransportError
    from runtime.link_watchdog import watched
    from runtime.logs import logger
    from runtime.scenario_file import attack_option, scenario_of
    from runtime.signals import stop_on_signals
    from runtime.zenoh_bus import ZenohBus

    scenario, loop = scenario_of(options.scenario), loop_of(options)
    attack = attack_option(options.attack, scenario.attack, None)
    if attack is None:
        raise UsageError("--attack: expected KIND@STEP, as the scenario has no [attack]")
    attacker = Attacker(scenario, attack, options.seed)
    if attacker.at != "bus":
        raise UsageError(f"attack.at: {attack.kind} is at the {attacker.at}: the plant hosts it")
    try:
        with (
            stop_on_signals() as stopping,
            ZenohBus(listen=[options.plant_side]) as plant,
            ZenohBus(listen=[options.controller_side]) as controller,
            watched(stopping, logger("attacker"), plant, controller),
        ):
            Relay(attacker, plant, controller, loop).run(stopping)
            attacker.sieve.tell()
    except TransportError as error:
        raise UsageError(str(error)) from None
    return DONE
