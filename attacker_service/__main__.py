"""``python -m attacker_service``: an attack on the field bus, between plant and controller."""

import sys

from runtime.command import Parser, carry_out, entered


def _command() -> int:
    from importlib import import_module

    module = import_module("attacker_service.command")
    parser = Parser(prog="python -m attacker_service", description="an attack on the field bus")
    module.add_arguments(parser)
    return int(module.run(parser.parse_args()))


if __name__ == "__main__":
    sys.exit(entered(lambda: carry_out(_command)))
