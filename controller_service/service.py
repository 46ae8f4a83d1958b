"""The controller service: its configuration, its endpoint, and the host that runs it."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from controller_service.endpoint import ControllerEndpoint
from controller_service.laws.base import CandidateLaw
from controller_service.telemetry import Telemetry
from protocol.link.sender import Sender
from protocol.link.session import rules_of
from protocol.runtime.bus import Bus
from protocol.runtime.host import Files, Host
from protocol.runtime.journal import ControllerJournal, JournalError
from protocol.runtime.process import UsageError, logger, new_id, spoken
from protocol.runtime.run_folder import (
    CONTROLLER_JOURNAL,
    CONTROLLER_KEYS,
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
)
from protocol.runtime.trace import TraceWriter
from protocol.scenario import Scenario
from protocol.secret.opening import open_keeper
from protocol.streams import CIPHER, symbols


@dataclass(frozen=True, slots=True)
class ControllerConfig:
    """What the controller service is started with.

    ``message`` is queued once in a journal's life, however often the service is started with it;
    ``seed`` is for experiments only; ``secret`` is a file that both ends share, by which key blocks
    are signed.
    """

    scenario: Scenario
    law: CandidateLaw
    run_dir: Path
    loop: str
    message: bytes | None = None
    seed: int | None = None
    secret: Path | None = None


class ControllerService:
    """Answers measurements with offers until it is told to stop.

    Parameters
    ----------
    config : ControllerConfig
    field, ops : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    clock : callable
        Monotonic seconds.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """

    def __init__(
        self,
        config: ControllerConfig,
        field: Bus,
        ops: Bus,
        stopping: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        scenario, seeded = config.scenario, config.seed is not None
        log = logger("controller")
        try:
            journal = ControllerJournal(config.run_dir / CONTROLLER_JOURNAL, scenario.fingerprint())
            record, step = journal.load(), journal.step()
            raws = journal.raws(None if record is None else record.session)
            keeper = open_keeper(
                config.run_dir / CONTROLLER_KEYS, "controller", scenario, config.seed, config.secret
            )
        except JournalError as error:
            raise UsageError(str(error)) from None
        self.trace = TraceWriter(
            config.run_dir / CONTROLLER_TRACE, "controller", scenario.identity()
        )
        rules = rules_of(scenario)
        fresh = symbols(config.seed, CIPHER)
        self.sender = Sender(
            rules, config.law.candidates, journal, fresh, new_id(), record, step, raws
        )
        self.endpoint = ControllerEndpoint(
            self.sender,
            journal,
            scenario.plant.period_s,
            message=config.message,
            telemetry=Telemetry(scenario.name, config.law, seeded=seeded),
        )
        self._host = Host(field, ops, stopping, clock)
        files = Files(journal, self.trace, config.run_dir / CONTROLLER_STATUS, keeper)
        self._host.add(config.loop, self.endpoint, files, log)
        if seeded:
            log.warning("seed %d: symbols are predictable, for experiments only", config.seed)
        log.info(
            "session %s, model %s, %d messages queued, %d delivered",
            self.sender.record.session or "none yet",
            spoken(scenario.fingerprint()),
            journal.queued,
            self.sender.record.message,
        )

    def run(self) -> int:
        """Answer until stopped; returns the exit code."""
        return self._host.run()


def run_controller(
    config: ControllerConfig, field: Bus, ops: Bus, stopping: threading.Event
) -> int:
    """Run the controller service on open buses; returns the exit code."""
    return ControllerService(config, field, ops, stopping).run()
