"""``wyner controller``, and ``python -m controller_service``."""

import argparse
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from runtime.bus_options import add_service_arguments
from runtime.end_service import EndOptions, run_end
from runtime.errors import UsageError
from runtime.logs import logger
from runtime.options import MessageOptions, message_of, option, picked

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from protocol.scenario import Scenario
    from runtime.fleet import FleetLoop


@dataclass(frozen=True, kw_only=True)
class ControllerOptions(MessageOptions, EndOptions):
    """The service's options."""

    clear_alarm: bool = option("offer inputs again after an alarm has stopped them", default=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the service's options."""
    parser.description = (
        "Run the controller: offer inputs for each state that the plant reports, and send the "
        "messages that are handed to it."
    )
    add_service_arguments(parser, "controller", ControllerOptions)


def run(args: argparse.Namespace) -> int:
    """Run until a signal comes.

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    from controller_service.service import ControllerConfig, add_controller

    options = picked(ControllerOptions, vars(args))
    law_of = cache(designed)  # loops of one scenario share one law

    def configure(common: dict[str, Any], loop: "FleetLoop") -> ControllerConfig:
        law: Any = None if options.check else law_of(common["scenario"])
        return ControllerConfig(
            **common, law=law, message=loop.message or None, clear_alarm=options.clear_alarm
        )

    message = message_of(options.message)
    return run_end(options, logger("controller"), message, configure, add_controller)


def designed(scenario: "Scenario") -> "CandidateLaw":
    """The scenario's law on its design, which is computed where the cache has none; shows progress.

    Raises
    ------
    UsageError
        When there is no design, or no law on it.
    """
    from controller_service.laws.errors import ProgramError
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.progress import shown_progress
    from controller_service.sets.design import SynthesisError

    try:
        with shown_progress() as progress:
            design = cached_design(scenario, progress)
        return make_law(scenario, design)
    except (SynthesisError, ProgramError) as error:
        raise UsageError(f"{scenario.name}: {error}") from None
