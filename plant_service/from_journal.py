"""The plant's endpoint as its journal has it: a new one, or one that goes on."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from plant_service.adapters.base import PlantAdapter, Stepped
from plant_service.adapters.operated import Operated
from plant_service.adapters.registry import is_model, open_plant
from plant_service.device import DevicePeer, DevicePlant
from plant_service.peer import PlantPeer
from plant_service.plant import Move, Plant, first_record, resuming_advance
from plant_service.status import PlantTelemetry
from protocol.link.pacing import STATUS_S, Pacing
from protocol.link.records import BegunStep, ReceiverRecord
from protocol.scenario import Scenario
from protocol.secret.nonces import Contribution
from protocol.streams import Stream, SymbolSource
from protocol.vectors import Vector
from runtime.errors import UsageError
from runtime.journal import ReceiverStep


class PlantDisk(Protocol):
    """What is read back from a journal."""

    def load(self) -> ReceiverRecord | None:
        """The record as last saved, or None in a new journal."""

    def step(self) -> ReceiverStep | None:
        """The step that followed it and was not counted, if any."""

    def begun(self) -> BegunStep | None:
        """The step that was begun and not read, if any."""

    def chunks(self) -> str:
        """Symbols of the frame under way that have left the record."""

    def contributions(self, session: str | None) -> list[Contribution]:
        """Rows of the session's key blocks that are not settled."""


def plant_endpoint(
    scenario: Scenario,
    journal: PlantDisk,
    coin: SymbolSource,
    noise: Stream,
    new_id: Callable[[], str],
    now: float,
    pacing: Pacing,
    *,
    steps: int | None = None,
    news: PlantTelemetry | None = None,
    status_s: float = STATUS_S,
    folder: Path = Path(),
    seed: int | None = None,
    own: Stepped | PlantAdapter | None = None,
) -> PlantPeer:
    """The endpoint of a scenario's plant, as its journal has it; the parameters are the classes'.

    Parameters
    ----------
    scenario, journal, coin, noise, new_id, now, pacing, steps, news, status_s
    folder : Path
        Where the files that the scenario's plant names are looked for.
    seed : int, optional
        For a plant with chance of its own.
    own : Stepped or PlantAdapter, optional
        In place of the scenario's plant.

    Raises
    ------
    PlantError
        When the plant cannot be opened or started; one line.
    UsageError
        When a device is to run at another pace than its own.
    """
    record, step = journal.load(), journal.step()
    operated, x = None, None
    if own is not None or not is_model(scenario):
        operated = open_plant(scenario, folder, own)
        try:
            if operated.device and pacing.step_s != scenario.plant.period_s:
                raise UsageError("--pace: expected realtime, as the plant is a device")
            x = operated.start(seed)
        except BaseException:
            operated.close()
            raise
    try:
        return _endpoint(
            scenario,
            journal,
            coin,
            noise,
            new_id,
            now,
            pacing,
            steps,
            news,
            status_s,
            operated,
            record,
            step,
            x,
        )
    except BaseException:  # it was started: whoever cannot go on leaves it safe
        if operated is not None:
            operated.safe("its service could not start")
            operated.close()
        raise


def _endpoint(
    scenario: Scenario,
    journal: PlantDisk,
    coin: SymbolSource,
    noise: Stream,
    new_id: Callable[[], str],
    now: float,
    pacing: Pacing,
    steps: int | None,
    news: PlantTelemetry | None,
    status_s: float,
    operated: Operated | None,
    record: ReceiverRecord | None,
    step: ReceiverStep | None,
    x: Vector | None,
) -> PlantPeer:
    """The endpoint of a plant that was started and reads ``x``, or of a computed one."""
    first = record or first_record(scenario, new_id(), x)
    said = None if step is None else step.measurement
    chunks, contributions = journal.chunks(), journal.contributions(first.session)
    pending = None if step is None else Move(step.offer, step.coin, step.measurement.x)
    watchdog_s = scenario.link.watchdog_s
    if operated is not None and (operated.device or not operated.resumable):
        return DevicePeer(
            DevicePlant(
                scenario, new_id(), coin, noise, first, chunks, contributions, said, operated
            ),
            pacing,
            new_id,
            now,
            pending=pending,
            begun=journal.begun(),
            back=None if record is None else x,
            fresh=record is None,
            steps=steps,
            news=news,
            watchdog_s=watchdog_s,
        )
    advance = None
    if operated is not None:
        advance = resuming_advance(operated, scenario.plant.disturbance.enters or "state")
    return PlantPeer(
        Plant(scenario, new_id(), coin, noise, first, chunks, contributions, said, advance),
        pacing,
        new_id,
        now,
        pending=pending,
        fresh=record is None,
        steps=steps,
        news=news,
        watchdog_s=watchdog_s,
        status_s=status_s,
    )
