"""The plant's core as its journal has it: a new one, or one that goes on."""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from plant_service.adapters.base import PlantAdapter, PlantError, Stepped
from plant_service.adapters.registry import NOISE_OF_ITS_OWN, is_model, open_plant
from plant_service.core import PlantCore
from plant_service.plant import (
    Disturbances,
    LinearModel,
    OperatedPlant,
    Plant,
    sensed,
)
from plant_service.status import PlantTelemetry
from protocol.link.channel import Channel, round_trip_s
from protocol.link.fallback import Fallback
from protocol.link.pacing import Pacing
from protocol.link.records import AppliedRecord, LinkRecord, PlantRecord, PlantSessionRecord
from protocol.link.session import rules_of
from protocol.link.step import Read
from protocol.scenario import AttackTable, Scenario
from protocol.secret.nonces import NonceSource
from protocol.streams import DISTURBANCE, SENSOR, Stream, SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import UsageError
from runtime.journal import PlantJournal

if TYPE_CHECKING:
    from attacker_service.attacker import Attacker


def first_record(
    scenario: Scenario, session: str, x: Vector | None = None, sensor_seed: int = 0
) -> PlantRecord:
    """The record of a plant that has not moved yet; ``x`` is its first reading, if it has one."""
    link = LinkRecord(0, scenario.initial_state if x is None else x)
    applied = AppliedRecord((0.0,) * scenario.m, sensor_seed=sensor_seed)
    return PlantRecord(PlantSessionRecord(session), link, applied)


def clock_scale(scenario: Scenario, pacing: Pacing) -> float:
    """Seconds of the process's clock in a second of the plant's; 1 in lock-step."""
    return 1.0 if pacing.step_s is None else pacing.step_s / scenario.plant.period_s


def open_core(
    scenario: Scenario,
    journal: PlantJournal,
    coin: SymbolSource,
    noise: Stream,
    new_id: Callable[[], str],
    now: float,
    pacing: Pacing,
    *,
    steps: int | None = None,
    news: PlantTelemetry | None = None,
    folder: Path = Path(),
    seed: int | None = None,
    sensors: Stream | None = None,
    own: Stepped | PlantAdapter | None = None,
    attack: AttackTable | None = None,
    nonces: NonceSource = fresh_nonce,
    channel: Channel | None = None,
) -> PlantCore:
    """The core of a scenario's plant, as its journal has it; its plant is started.

    Parameters
    ----------
    scenario : Scenario
    journal : PlantJournal
    coin : SymbolSource
        b_r; draw j belongs to transition j.
    new_id, now, pacing, steps, news, nonces, channel
        As of :class:`plant_service.core.PlantCore`.
    noise : Stream
        Uniform numbers for the simulated disturbance; draw k belongs to step k.
    folder : Path
        Where the files that the scenario's plant names are looked for.
    seed : int, optional
        For a plant with chance of its own.
    sensors : Stream, optional
        Uniform numbers for the sensors' noise; draw k belongs to y(k). None: of a seed that the
        journal has, or a new one has from now on; so is then, where outputs are read, ``noise``.
    own : Stepped or PlantAdapter, optional
        In place of the scenario's plant.
    attack : AttackTable, optional
        On this plant, or on its bus.

    Raises
    ------
    PlantError
        When the plant cannot be opened or started; one line.
    UsageError
        When a device is to run at another pace than its own, or the attack cannot be made.
    """
    loaded = journal.load()
    record, step = loaded.record, loaded.step
    attacker = None if attack is None else _attacker(scenario, attack, seed)
    sensor_seed = secrets.randbits(62) if record is None else record.applied.sensor_seed
    spec, observer = scenario.plant.noise, scenario.observer
    if observer is not None and sensors is None:  # a step is made again with the same d
        widths = scenario.plant.disturbance.half_widths
        noise = Stream(sensor_seed, DISTURBANCE, width=len(widths))
    disturbances = Disturbances(scenario, noise)
    plant: Plant
    x: Vector | None = None
    if own is None and is_model(scenario):
        plant = LinearModel(scenario, disturbances)
    else:
        operated = open_plant(scenario, folder, own)
        try:
            if operated.device and pacing.step_s != scenario.plant.period_s:
                raise UsageError("--pace: expected realtime, as the plant is a device")
            if operated.device and spec is not None:
                raise PlantError(NOISE_OF_ITS_OWN)
            x = operated.start(seed)
        except BaseException:
            operated.close()
            raise
        enters = scenario.plant.disturbance.enters or "state"
        plant = OperatedPlant(operated, disturbances, enters)
    try:
        draws = sensors or Stream(sensor_seed, SENSOR, width=scenario.readings)
        at_plant = None if attacker is None or attacker.at == "bus" else attacker
        last = None
        if isinstance(step, Read):
            last = (step.report, step.offer.candidates[step.coin])
        plant, x = sensed(plant, scenario, at_plant, draws, x, record, last)
        if attacker is not None and news is not None:
            news.attack = attacker.began.sentence()
        first = None
        if record is None:
            seeded = spec is not None or observer is not None
            first = first_record(scenario, new_id(), x, sensor_seed if seeded else 0)
        return PlantCore(
            rules_of(scenario),
            plant,
            coin,
            Fallback.of(scenario).input,
            pacing,
            new_id,
            now,
            instance=new_id(),
            loaded=loaded,
            first=first,
            back=x if plant.acts and record is not None else None,
            steps=steps,
            news=news,
            watchdog_s=scenario.link.watchdog_s,
            round_trip_s=round_trip_s(scenario) * clock_scale(scenario, pacing),
            attack=None if attacker is None else attacker.began,
            nonces=nonces,
            channel=channel,
        )
    except BaseException:  # it was started: whoever cannot go on leaves it safe
        plant.safe("its service could not start")
        plant.close()
        raise


def _attacker(scenario: Scenario, attack: AttackTable, seed: int | None) -> "Attacker":
    """The attack; its code is loaded where there is one."""
    from attacker_service.attacker import Attacker

    return Attacker(scenario, attack, seed)
