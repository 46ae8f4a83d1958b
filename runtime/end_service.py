"""One end of one loop as a service, or that of each loop of a fleet: hosts, and their options."""

import logging
import threading
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from protocol.link.endpoint import Endpoint
from protocol.scenario import Scenario
from runtime.bus import Bus
from runtime.bus_options import ServiceOptions, buses_of, check_addresses, fleet_of, loop_of
from runtime.collection import freeze_startup
from runtime.errors import Failure, UsageError
from runtime.fleet import Fleet, FleetLoop
from runtime.host import Host
from runtime.options import fine, folder_of, option, pace_of, run_dir_of
from runtime.pace import Pace
from runtime.ports import Files
from runtime.recording import Bounds
from runtime.scenario_file import keep_scenario, scenario_of
from runtime.shipped import scenario_file_of

E = TypeVar("E", bound=Endpoint)


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
    the scenario names are looked for; ``bounds`` are the trace's.
    """

    scenario: Scenario
    run_dir: Path
    loop: str
    pace: Pace = field(default_factory=lambda: Pace("realtime"))
    _: KW_ONLY
    seed: int | None = None
    folder: Path = Path()
    bounds: Bounds = field(default_factory=Bounds)


class EndService(Generic[E]):
    """Runs one end until it is told to stop, or until it is over.

    Parameters
    ----------
    config : EndConfig
    opened : tuple of Endpoint and Files
        The end of the loop as its journal has it.
    log : logging.Logger
    field, management : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    clock : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        config: EndConfig,
        opened: tuple[E, Files],
        log: logging.Logger,
        field: Bus,
        management: Bus,
        stopping: threading.Event,
        clock: Callable[[], float],
    ) -> None:
        self.endpoint, files = opened
        self.trace = files.trace
        self._host = Host(field, management, stopping, clock)
        self._host.add(config.loop, self.endpoint, files, log)
        if config.seed is not None:
            log.warning("seed %d: symbols are predictable, for experiments only", config.seed)

    def run(self) -> int:
        """Run until stopped, or until the end is over; returns the exit code."""
        return self._host.run()


Common = dict[str, Any]
"""What a loop's end is started with, as of :class:`EndConfig`."""

Open = Callable[[Common, FleetLoop, int], tuple[Endpoint, Files]]
"""Opens one end of a loop, the nth of its host, as its journal has it.

It raises UsageError, Failure or OSError where that cannot be.
"""


def run_end(
    options: EndOptions,
    log: logging.Logger,
    message: bytes | None,
    own: Callable[[Scenario], Common],
    single: Callable[[Common, Bus, Bus, threading.Event], EndService[Any]],
    open_end: Open,
) -> int:
    """Run one end, or that of each loop of a fleet, until it is over; returns the exit code.

    Parameters
    ----------
    options : EndOptions
    log : logging.Logger
        Of the service, by its name.
    message : bytes, optional
        For each loop of a numbered fleet.
    own : callable
        What a single end is started with besides.
    single : callable
        The service of one loop on its buses.
    open_end : callable

    Raises
    ------
    UsageError
        When an option's value is wrong.
    """
    check_addresses(options, log.name)
    common = partial(dict[str, Any], pace=pace_of(options.pace), bounds=options.bounds)
    fleet = fleet_of(options, message)
    if fleet is not None:
        if options.check:
            check_loops(fleet)
            return fine(f"{len(fleet.loops)} loops")
        folder = run_dir_of(options.run_dir)
        with buses_of(options, log.name) as (stopping, field_bus, management):
            return run_fleet(fleet, folder, common, open_end, field_bus, management, stopping, log)
    scenario = scenario_of(options.scenario)
    folder = folder_of("--folder", options.folder, scenario_file_of(options.scenario).parent)
    besides = own(scenario)
    if options.check:
        return fine(f"scenario {scenario.name}")
    run_dir = run_dir_of(options.run_dir)
    told = common(
        scenario=scenario,
        run_dir=run_dir,
        loop=loop_of(options.loop),
        seed=options.seed,
        folder=folder,
        **besides,
    )
    with buses_of(options, log.name) as (stopping, field_bus, management):
        keep_scenario(run_dir, options.scenario)
        return single(told, field_bus, management, stopping).run()


def check_loops(fleet: Fleet) -> None:
    """Read the scenario of every loop; start nothing.

    Raises
    ------
    UsageError
        With the lines of each scenario that is wrong; where loops stand in a file, after the first
        one that has it.
    """
    first: dict[str, str] = {}
    for loop in fleet.loops.values():
        first.setdefault(loop.scenario, loop.id)
    problems: list[str] = []
    for scenario, loop_id in first.items():
        try:
            scenario_of(scenario)
        except UsageError as error:
            where = "" if fleet.path is None else f"{loop_id}: "
            problems += [f"{where}{line}" for line in error.lines]
    if problems:
        raise UsageError(problems)


def run_fleet(
    fleet: Fleet,
    run_dir: Path,
    common: Callable[..., Common],
    open_end: Open,
    field_bus: Bus,
    management: Bus,
    stopping: threading.Event,
    log: logging.Logger,
) -> int:
    """Run one end of every loop of a fleet until told to stop; returns the exit code.

    ``common`` makes of a loop's own keywords what its end is started with. A loop that cannot be
    opened, or fails, is logged, and harms no other.
    """
    host = Host(field_bus, management, stopping, fleet=True)
    scenarios: dict[str, Scenario] = {}
    for number, loop in enumerate(fleet.loops.values(), start=1):
        folder = run_dir / loop.id
        try:
            keep_scenario(folder, loop.scenario)
            if loop.scenario not in scenarios:
                scenarios[loop.scenario] = scenario_of(loop.scenario)
            told = common(
                scenario=scenarios[loop.scenario],
                run_dir=folder,
                loop=loop.id,
                seed=loop.seed,
                folder=scenario_file_of(loop.scenario).parent,
            )
            host.add(loop.id, *open_end(told, loop, number), log.getChild(loop.id))
        except (UsageError, Failure, OSError) as error:
            log.error("loop %s: %s", loop.id, str(error).replace("\n", "; "))
        except Exception as error:
            log.error("loop %s: unexpected %s: %s", loop.id, type(error).__name__, error)
    freeze_startup()
    log.info("%d of %d loops run", len(host.loops), len(fleet.loops))
    return host.run()
