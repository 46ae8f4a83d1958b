"""One end of one loop as a service, or that of each loop of a fleet: hosts, and their options."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from protocol.link.pacing import STATUS_S
from protocol.scenario import Scenario, ScenarioError
from runtime.bus_options import ServiceOptions, buses_of, endpoints_of
from runtime.collection import freeze_startup
from runtime.errors import UsageError, in_a_line
from runtime.fleet import FLEET_STATUS_S, FleetLoop, loops_of
from runtime.host import Host
from runtime.options import fine, folder_of, option, pace_of, run_dir_of
from runtime.pace import Pace
from runtime.recording import Bounds
from runtime.scenario_file import keep_scenario, scenario_of
from runtime.shipped import scenario_file_of
from runtime.signals import stop_on_signals


@dataclass(frozen=True, kw_only=True)
class EndOptions(ServiceOptions):
    """Options of either end."""

    scenario: str = option("file or shipped name", "S", "sustained")
    pace: str = option("of the plant: realtime, xN, or fast (lock-step)", "P", "realtime")
    folder: str | None = option(
        "folder of the files that the scenario names (default: the scenario's own)", "D"
    )


@dataclass(frozen=True, slots=True)
class EndConfig:
    """What either end is started with.

    ``pace`` is the plant's; ``seed`` is for experiments only; ``folder`` is where the files that
    the scenario names are looked for; ``bounds`` are the trace's; ``status_s`` are the seconds
    between statuses.
    """

    scenario: Scenario
    run_dir: Path
    loop: str
    pace: Pace = field(default_factory=lambda: Pace("realtime"))
    _: KW_ONLY
    seed: int | None = None
    folder: Path = Path()
    bounds: Bounds = field(default_factory=Bounds)
    status_s: float = STATUS_S


C = TypeVar("C", bound=EndConfig)

Configure = Callable[[dict[str, Any], FleetLoop], C]
"""Makes an end's configuration of the keywords that are :class:`EndConfig`'s.

It raises UsageError where an option or the scenario is wrong.
"""

Add = Callable[[Host, C, logging.Logger], object]
"""Opens one end of a loop as its journal has it, and adds it to a host.

It raises UsageError, Failure or OSError where that cannot be.
"""


def run_end(
    options: EndOptions,
    log: logging.Logger,
    message: bytes | None,
    configure: Configure[C],
    add: Add[C],
) -> int:
    """Run one end, or that of each loop of a fleet, until it is over; returns the exit code.

    A fleet runs until it is stopped. A loop of it that cannot be opened, or fails, is logged, and
    harms no other.

    Parameters
    ----------
    options : EndOptions
    log : logging.Logger
        Of the service, by its name.
    message : bytes, optional
        For the loop, or for each one of a numbered fleet.
    configure, add : callable

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    ends = endpoints_of(options, log.name)
    pace, scenarios = pace_of(options.pace), cache(scenario_of)
    loops, many = loops_of(options, message), options.fleet is not None

    def configured(loop: FleetLoop, run_dir: Path) -> C:
        common = {
            "scenario": scenarios(loop.scenario),
            "run_dir": run_dir,
            "loop": loop.id,
            "pace": pace,
            "seed": loop.seed,
            "folder": folder_of("--folder", options.folder, scenario_file_of(loop.scenario).parent),
            "bounds": Bounds(total_bytes=options.total_bytes),
            "status_s": FLEET_STATUS_S if many else STATUS_S,
        }
        return configure(common, loop)

    check_loops(loops, configured, many=many)
    if options.check and many:
        return fine(f"{len(loops)} loops")
    if options.check:
        return fine(f"scenario {scenarios(options.scenario).name}")
    run_dir = run_dir_of(options.run_dir)
    if options.seed is not None and not many:
        log.warning("seed %d: symbols are predictable, for experiments only", options.seed)
    with (
        stop_on_signals() as stopping,
        buses_of(ends, stopping, log, options.metrics) as (field_bus, management),
    ):
        host = Host(field_bus, management, stopping, fleet=many)
        for loop in loops:
            folder = run_dir / loop.id if many else run_dir
            try:
                keep_scenario(folder, loop.scenario)
                add(host, configured(loop, folder), log.getChild(loop.id) if many else log)
            except Exception as error:
                if not many:
                    raise
                log.error("loop %s: %s", loop.id, in_a_line(error))
        freeze_startup()
        if many:
            log.info("%d of %d loops run", len(host.loops), len(loops))
        return host.run()


def check_loops(
    loops: Sequence[FleetLoop], configured: Callable[[FleetLoop, Path], EndConfig], *, many: bool
) -> None:
    """Look at the scenario of every loop, and at what is told with it; start nothing.

    Raises
    ------
    UsageError
        With the lines of each scenario that is wrong, of a fleet's after its first loop's id.
    """
    first: dict[str, FleetLoop] = {}
    for loop in loops:
        first.setdefault(loop.scenario, loop)
    problems: list[str] = []
    for loop in first.values():
        try:
            configured(loop, Path())
        except (UsageError, ScenarioError) as error:
            where = f"{loop.id}: " if many else ""
            problems += [f"{where}{line}" for line in error.problems]
    if problems:
        raise UsageError(problems)
