"""The plant service: its configuration, and its core on the host that runs it."""

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from plant_service.adapters.base import PlantError
from plant_service.core import PlantCore
from plant_service.opening import open_core
from plant_service.plant import FilteredPlant
from plant_service.status import PlantTelemetry
from protocol.link.channel import channel_of
from protocol.link.pacing import Pacing
from protocol.scenario import AttackTable
from protocol.streams import COIN, SENSOR, Stream
from runtime.chance import new_id, noise, symbols
from runtime.end_service import EndConfig
from runtime.errors import UsageError
from runtime.files import read_regular, write_atomically
from runtime.fleet import SLOTS
from runtime.host import Host
from runtime.journal import JournalError, PlantJournal
from runtime.ports import Files
from runtime.recording import TraceWriter
from runtime.run_folder import (
    PLANT_JOURNAL,
    PLANT_SAFE,
    PLANT_STATUS,
    PLANT_TRACE,
)


@dataclass(frozen=True, slots=True)
class PlantConfig(EndConfig):
    """What the plant service is started with; ``steps`` ends it when k reaches that number.

    ``attack`` is on this plant, or on its bus. ``clear_safe``: a plant runs that is in its safe
    state.
    """

    steps: int | None = None
    attack: AttackTable | None = None
    clear_safe: bool = False


def open_plant(
    config: PlantConfig, now: float, *, phase: float | None = None
) -> tuple[PlantCore, Files]:
    """The plant's end of one loop as its journal has it, and its files.

    Parameters
    ----------
    config : PlantConfig
    now : float
        Monotonic seconds.
    phase : float, optional
        :class:`protocol.link.pacing.Pacing`'s.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """
    scenario, seeded = config.scenario, config.seed is not None
    with ExitStack() as undone:
        try:
            journal = PlantJournal(config.run_dir / PLANT_JOURNAL, scenario.fingerprint())
            undone.callback(journal.close)
            news = PlantTelemetry.of(
                scenario, config.pace.text, seeded=seeded, status_s=config.status_s
            )
            if (last := journal.last_message()) is not None:
                news.last_message = last
            step_s = config.pace.step_s(scenario.plant.period_s)
            core = open_core(
                scenario,
                journal,
                symbols(config.seed, COIN),
                noise(config.seed, len(scenario.plant.disturbance.half_widths)),
                new_id,
                now,
                Pacing(step_s, scenario.link.repeats_per_period, now, phase),
                steps=config.steps,
                news=news,
                folder=config.folder,
                seed=config.seed,
                sensors=None
                if config.seed is None
                else Stream(config.seed, SENSOR, width=scenario.readings),
                attack=config.attack,
                channel=channel_of(scenario, "to_plant", scale=config.pace.scale, seed=config.seed),
            )
            undone.callback(let_go, core)
            trace = TraceWriter(
                config.run_dir / PLANT_TRACE, "plant", scenario.identity(), config.bounds
            )
        except (JournalError, PlantError) as error:
            raise UsageError(str(error)) from None
        undone.pop_all()
    return core, Files(journal, trace, config.run_dir / PLANT_STATUS)


def let_go(core: PlantCore) -> None:
    """Leave the plant in its safe state when its service cannot start."""
    core.stepper.plant.safe("its service could not start")
    core.stepper.plant.close()


def add_plant(host: Host, config: PlantConfig, log: logging.Logger) -> PlantCore:
    """Open the plant's end of one loop, and have a host run it.

    Where the plant fails or the watchdog bites, it is in its safe state, and a mark in the run's
    folder keeps it there.

    Raises
    ------
    UsageError
        When the journal or the plant cannot be used, or the plant is in its safe state.
    """
    scenario, mark = config.scenario, config.run_dir / PLANT_SAFE
    if config.clear_safe:
        mark.unlink(missing_ok=True)
    if mark.exists():
        why = read_regular(mark).decode().strip()
        raise UsageError(
            f"the plant is in its safe state: {why} (look at it, then wyner plant --clear-safe)"
        )
    phase = len(host.loops) % SLOTS / SLOTS if host.fleet else None
    core, files = open_plant(config, time.monotonic(), phase=phase)
    plant = core.stepper.plant
    heard = plant.overheard(host.field, config.loop) if isinstance(plant, FilteredPlant) else None
    try:
        host.add(config.loop, core, files, log, heard, partial(_keep_safe, mark, log))
    except BaseException:
        let_go(core)
        raise
    code = getattr(scenario.plant, "object", None)
    if code is not None:
        log.info("plant.object: running %s, from %s", code, config.folder.resolve())
    log.info(
        "session %s, model %s, step %d, pace %s",
        core.state.session.record.id,
        scenario.fingerprint()[:8],
        core.state.link.k,
        config.pace.text,
    )
    return core


def _keep_safe(mark: Path, log: logging.Logger, error: Exception) -> None:
    """Mark that a plant which has failed is in its safe state."""
    if not isinstance(error, PlantError):
        return
    try:
        write_atomically(mark, f"{error}\n".encode())
    except OSError as full:
        log.error("%s cannot be written: %s", mark, full.strerror)
