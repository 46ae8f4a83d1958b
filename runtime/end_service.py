"""One end of one loop as a service: a host with one endpoint."""

import logging
import threading
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from protocol.link.endpoint import Endpoint
from protocol.scenario import Scenario
from runtime.bus import Bus
from runtime.host import Host
from runtime.ports import Files
from runtime.recording import Bounds

E = TypeVar("E", bound=Endpoint)


@dataclass(frozen=True, slots=True)
class EndConfig:
    """What either end is started with.

    ``seed`` is for experiments only; ``folder`` is where the files that the scenario names are
    looked for; ``bounds`` are the trace's.
    """

    scenario: Scenario
    run_dir: Path
    loop: str
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
