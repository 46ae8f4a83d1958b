"""The plant's endpoint as its journal has it: a new one, or one that goes on."""

from collections.abc import Callable
from typing import Protocol

from plant_service.endpoint import PlantEndpoint
from plant_service.plant import Move, Plant, first_record
from plant_service.status import News
from protocol.link.pacing import Pacing
from protocol.link.receiver import ReceiverRecord
from protocol.runtime.journal import ReceiverStep
from protocol.scenario import Scenario
from protocol.secret.nonces import Raw
from protocol.streams import Stream, SymbolSource


class PlantDisk(Protocol):
    """What is read back from a journal."""

    def load(self) -> ReceiverRecord | None:
        """The record as last saved, or None in a new journal."""

    def step(self) -> ReceiverStep | None:
        """The step that followed it and was not counted, if any."""

    def chunks(self) -> str:
        """Symbols of the frame under way that have left the record."""

    def raws(self, session: str | None) -> list[Raw]:
        """Rows of the session's key blocks that are not settled."""


def plant_endpoint(
    scenario: Scenario,
    journal: PlantDisk,
    coin: SymbolSource,
    noise: Stream,
    new_id: Callable[[], str],
    now: float,
    step_s: float | None,
    *,
    steps: int | None = None,
    news: News | None = None,
) -> PlantEndpoint:
    """The endpoint of a scenario's plant, as its journal has it; the parameters are the classes'.

    ``step_s`` is :class:`protocol.link.pacing.Pacing`'s.
    """
    record, step = journal.load(), journal.step()
    first = record or first_record(scenario, new_id())
    return PlantEndpoint(
        Plant(
            scenario,
            new_id(),
            coin,
            noise,
            first,
            journal.chunks(),
            journal.raws(first.session),
            None if step is None else step.measurement,
        ),
        Pacing(step_s, scenario.link.repeats_per_period, now),
        new_id,
        now,
        pending=None if step is None else Move(step.offer, step.coin, step.measurement.x),
        fresh=record is None,
        steps=steps,
        news=news,
    )
