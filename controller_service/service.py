"""The controller service: its configuration, its endpoint, and the host that runs it."""

import threading
import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

from controller_service.core import ControllerCore
from controller_service.laws.base import CandidateLaw
from controller_service.telemetry import ControllerTelemetry
from protocol.link.channel import channel_of
from protocol.link.endpoint import Endpoint
from protocol.link.pacing import STATUS_S
from protocol.link.records import ControllerRecord
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from protocol.streams import CIPHER
from runtime.bus import Bus
from runtime.chance import new_id, symbols
from runtime.end_service import Common, EndConfig, EndService, Open
from runtime.errors import UsageError
from runtime.fleet import STATUS_S as FLEET_STATUS_S
from runtime.fleet import FleetLoop
from runtime.journal import ControllerJournal, JournalError
from runtime.logs import logger
from runtime.ports import Files
from runtime.recording import TraceWriter
from runtime.run_folder import (
    CONTROLLER_JOURNAL,
    CONTROLLER_STATUS,
    CONTROLLER_TRACE,
)
from runtime.user_code import UserCodeError, load_model


@dataclass(frozen=True, slots=True)
class ControllerConfig(EndConfig):
    """What the controller service is started with.

    ``message`` is queued once, however often the service is started with it.
    ``clear_alarm``: offers go on that an alarm has ended.
    """

    _: KW_ONLY
    law: CandidateLaw
    message: bytes | None = None
    clear_alarm: bool = False


def open_controller(
    config: ControllerConfig, *, status_s: float = STATUS_S
) -> tuple[ControllerCore, Files]:
    """The controller's end of one loop as its journal has it, and its files.

    Parameters
    ----------
    config : ControllerConfig
    status_s : float
        Seconds between statuses.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """
    scenario = config.scenario
    try:
        journal = ControllerJournal(config.run_dir / CONTROLLER_JOURNAL, scenario.fingerprint())
        loaded = journal.load()
        if loaded.record is not None and config.clear_alarm:
            loaded = loaded._replace(record=_going_on(loaded.record))
        predict = load_model(scenario, config.folder)
    except (JournalError, UserCodeError) as error:
        raise UsageError(str(error)) from None
    except UsageError:
        journal.close()
        raise
    trace = TraceWriter(
        config.run_dir / CONTROLLER_TRACE, "controller", scenario.identity(), config.bounds
    )
    core = ControllerCore(
        rules_of(scenario),
        config.law.candidates,
        journal,
        symbols(config.seed, CIPHER),
        instance=new_id(),
        period_s=scenario.plant.period_s,
        loaded=loaded,
        predict=predict,
        message=config.message,
        news=ControllerTelemetry(config.law, status_s),
        channel=channel_of(scenario, "to_controller", scale=config.pace.scale, seed=config.seed),
    )
    return core, Files(journal, trace, config.run_dir / CONTROLLER_STATUS)


def _going_on(record: ControllerRecord) -> ControllerRecord:
    """The record, with offers going on that an alarm has ended."""
    return record._replace(alarms=record.alarms._replace(halted=False))


class ControllerService(EndService[ControllerCore]):
    """Answers one plant's measurements with offers until it is told to stop.

    Its parameters are those of :class:`EndService`.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """

    def __init__(
        self,
        config: ControllerConfig,
        field: Bus,
        management: Bus,
        stopping: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        log = logger("controller")
        super().__init__(
            config,
            open_controller(config),
            log,
            field,
            management,
            stopping,
            clock,
        )
        core = self.endpoint
        log.info(
            "session %s, model %s, %d messages queued, %d delivered",
            core.state.session.record.id or "none yet",
            config.scenario.fingerprint()[:8],
            core.state.messages.queued,
            core.state.frame.record.message,
        )


def open_in_fleet(law_of: Callable[[Scenario], CandidateLaw]) -> Open:
    """What opens the controller's end of a loop, under the law of its scenario."""

    def open_end(told: Common, loop: FleetLoop, _number: int) -> tuple[Endpoint, Files]:
        law = law_of(told["scenario"])
        config = ControllerConfig(**told, law=law, message=loop.payload)
        return open_controller(config, status_s=FLEET_STATUS_S)

    return open_end
