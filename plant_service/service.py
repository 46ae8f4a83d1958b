"""The plant service: its configuration, its core, and the host that runs it."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from plant_service.adapters.base import PlantError
from plant_service.adapters.registry import is_model
from plant_service.core import PlantCore
from plant_service.opening import open_core
from plant_service.plant import FilteredPlant
from plant_service.status import PlantTelemetry
from protocol.link.channel import channel_of
from protocol.link.endpoint import Endpoint
from protocol.link.pacing import STATUS_S, Pacing
from protocol.scenario import AttackTable
from protocol.streams import COIN, SENSOR, Stream
from runtime.bus import Bus
from runtime.chance import new_id, noise, symbols
from runtime.end_service import Common, EndConfig, EndService
from runtime.errors import UsageError
from runtime.files import read_regular, write_atomically
from runtime.fleet import SLOTS, FleetLoop
from runtime.fleet import STATUS_S as FLEET_STATUS_S
from runtime.journal import JournalError, PlantJournal
from runtime.logs import logger
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

    ``attack`` is on this plant, or on its bus.
    """

    steps: int | None = None
    attack: AttackTable | None = None


def open_plant(
    config: PlantConfig, now: float, *, phase: float | None = None, status_s: float = STATUS_S
) -> tuple[PlantCore, Files]:
    """The plant's end of one loop as its journal has it, and its files.

    Parameters
    ----------
    config : PlantConfig
    now : float
        Monotonic seconds.
    phase : float, optional
        :class:`protocol.link.pacing.Pacing`'s.
    status_s : float
        Seconds between statuses.

    Raises
    ------
    UsageError
        When the journal cannot be used.
    """
    with ExitStack() as undone:
        try:
            core, files = _opened(config, now, phase, status_s, undone)
        except (JournalError, PlantError) as error:
            raise UsageError(str(error)) from None
        undone.pop_all()
    return core, files


def let_go(core: PlantCore) -> None:
    """Leave the plant in its safe state when its service cannot start."""
    core.stepper.plant.safe("its service could not start")
    core.stepper.plant.close()


def _opened(
    config: PlantConfig, now: float, phase: float | None, status_s: float, undone: ExitStack
) -> tuple[PlantCore, Files]:
    """As :func:`open_plant`; ``undone`` closes what is open where something fails."""
    scenario, seeded = config.scenario, config.seed is not None
    journal = PlantJournal(config.run_dir / PLANT_JOURNAL, scenario.fingerprint())
    undone.callback(journal.close)
    news = PlantTelemetry.of(scenario, config.pace.text, seeded=seeded, status_s=status_s)
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
    trace = TraceWriter(config.run_dir / PLANT_TRACE, "plant", scenario.identity(), config.bounds)
    return core, Files(journal, trace, config.run_dir / PLANT_STATUS)


class PlantService(EndService[PlantCore]):
    """Runs one plant until it is told to stop, or has made its steps.

    Its parameters are those of :class:`EndService`.

    Raises
    ------
    UsageError
        When the journal or the plant cannot be used, or the plant is in its safe state.
    """

    def __init__(
        self,
        config: PlantConfig,
        field: Bus,
        management: Bus,
        stopping: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._safe_state = config.run_dir / PLANT_SAFE
        if self._safe_state.exists():
            why = read_regular(self._safe_state).decode().strip()
            raise UsageError(
                f"the plant is in its safe state: {why} (look at it, then wyner plant --clear-safe)"
            )
        log, opened = logger("plant"), open_plant(config, clock())
        plant = opened[0].stepper.plant
        if isinstance(plant, FilteredPlant):
            field = plant.overheard(field, config.loop)
        try:
            super().__init__(config, opened, log, field, management, stopping, clock)
        except BaseException:
            let_go(opened[0])
            raise
        state = self.endpoint.state
        code = getattr(config.scenario.plant, "object", None)
        if code is not None:
            log.info("plant.object: running %s, from %s", code, config.folder.resolve())
        log.info(
            "session %s, model %s, step %d, pace %s",
            state.session.record.id,
            config.scenario.fingerprint()[:8],
            state.link.k,
            config.pace.text,
        )

    def run(self) -> int:
        """Step until stopped; returns the exit code.

        Raises
        ------
        PlantError
            When the plant failed or the watchdog bit; it is in its safe state then, and a mark in
            the run's folder keeps it there.
        """
        try:
            return super().run()
        except PlantError as error:
            try:
                write_atomically(self._safe_state, f"{error}\n".encode())
            except OSError as full:
                reason = f"and {self._safe_state} cannot be written: {full.strerror}"
                raise PlantError(f"{error}; {reason}") from error
            raise


def open_in_fleet(told: Common, _loop: FleetLoop, number: int) -> tuple[Endpoint, Files]:
    """The plant's end of a loop, the nth of its host.

    Raises
    ------
    UsageError
        When its plant is no linear model.
    """
    config = PlantConfig(**told)
    if not is_model(config.scenario):
        kind = config.scenario.plant.kind
        raise UsageError(f"plant.kind: got {kind!r}, expected linear in a fleet")
    phase = number % SLOTS / SLOTS
    return open_plant(config, time.monotonic(), phase=phase, status_s=FLEET_STATUS_S)
