"""``python -m attacker_service``: an attack on the field bus, as ``wyner up`` starts it."""

import sys
from dataclasses import dataclass

from protocol.topics import DEFAULT_LOOP
from runtime.bus_options import buses_of, loop_of
from runtime.command import Parser, carry_out, entered
from runtime.errors import DONE, UsageError
from runtime.options import add_arguments, option, picked


@dataclass(frozen=True, kw_only=True)
class AttackerOptions:
    """The service's options."""

    scenario: str = option("file or shipped name", "S", ...)
    attack: str | None = option("in place of the scenario's [attack]", "KIND@STEP")
    loop: str = option("id of the control loop", "ID", DEFAULT_LOOP)
    seed: int | None = option("for experiments: predictable draws", "N", least=0)
    plant_side: str = option(
        "listen there for the plant, such as tcp/127.0.0.1:7461", "ENDPOINT", ...
    )
    controller_side: str = option(
        "listen there for the controller, such as tcp/127.0.0.1:7461", "ENDPOINT", ...
    )


def run() -> int:
    """Pass messages on until a signal comes.

    Raises
    ------
    UsageError
        When an option's value is wrong, or no such attack is at the bus.
    """
    from attacker_service.attacker import Attacker
    from attacker_service.relay import Relay
    from runtime.addresses import Addresses
    from runtime.logs import logger
    from runtime.scenario_file import attack_option, scenario_of
    from runtime.signals import stop_on_signals

    parser = Parser(prog="python -m attacker_service", description="an attack on the field bus")
    add_arguments(parser, AttackerOptions)
    told = picked(AttackerOptions, vars(parser.parse_args()))
    scenario, loop = scenario_of(told.scenario), loop_of(told.loop)
    attack = attack_option(told.attack, scenario.attack, None)
    if attack is None:
        raise UsageError("--attack: expected KIND@STEP, as the scenario has no [attack]")
    attacker = Attacker(scenario, attack, told.seed)
    if attacker.at != "bus":
        raise UsageError(f"attack.at: {attack.kind} is at the {attacker.at}: the plant hosts it")
    ends = {
        "plant": Addresses(listen=(told.plant_side,)),
        "controller": Addresses(listen=(told.controller_side,)),
    }
    with (
        stop_on_signals() as stopping,
        buses_of(ends, stopping, logger("attacker")) as (plant, controller),
    ):
        Relay(attacker, plant, controller, loop).run(stopping)
    return DONE


if __name__ == "__main__":
    sys.exit(entered(lambda: carry_out(run)))
