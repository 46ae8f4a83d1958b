"""The controller service: its configuration, and its endpoint on the host that runs it."""

import logging
from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass

from controller_service.core import ControllerCore
from controller_service.laws.base import CandidateLaw
from controller_service.telemetry import ControllerTelemetry
from protocol.link.channel import channel_of
from protocol.link.session import rules_of
from protocol.streams import CIPHER
from runtime.chance import new_id, symbols
from runtime.end_service import EndConfig
from runtime.errors import UsageError
from runtime.host import Host
from runtime.journal import ControllerJournal, JournalError
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


def open_controller(config: ControllerConfig) -> tuple[ControllerCore, Files]:
    """The controller's end of one loop as its journal has it, and its files.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """
    scenario = config.scenario
    with ExitStack() as undone:
        try:
            journal = ControllerJournal(config.run_dir / CONTROLLER_JOURNAL, scenario.fingerprint())
            undone.callback(journal.close)
            loaded = journal.load()
            predict = load_model(scenario, config.folder)
        except (JournalError, UserCodeError) as error:
            raise UsageError(str(error)) from None
        if loaded.record is not None and config.clear_alarm:
            alarms = loaded.record.alarms._replace(halted=False)
            loaded = loaded._replace(record=loaded.record._replace(alarms=alarms))
        trace = TraceWriter(
            config.run_dir / CONTROLLER_TRACE, "controller", scenario.identity(), config.bounds
        )
        undone.callback(trace.close)
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
            news=ControllerTelemetry(config.law, config.status_s),
            channel=channel_of(
                scenario, "to_controller", scale=config.pace.scale, seed=config.seed
            ),
        )
        undone.pop_all()
    return core, Files(journal, trace, config.run_dir / CONTROLLER_STATUS)


def add_controller(host: Host, config: ControllerConfig, log: logging.Logger) -> ControllerCore:
    """Open the controller's end of one loop, and have a host run it.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """
    core, files = open_controller(config)
    host.add(config.loop, core, files, log)
    log.info(
        "session %s, model %s, %d messages queued, %d delivered",
        core.state.session.record.id or "none yet",
        config.scenario.fingerprint()[:8],
        core.state.messages.queued,
        core.state.frame.record.message,
    )
    return core
