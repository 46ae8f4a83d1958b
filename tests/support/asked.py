"""What an end asked its shell for, gathered."""

from collections.abc import Iterator
from functools import reduce
from typing import Final, NamedTuple

from protocol.link.effects import Effect, Effects, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import Event
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.messages import Message, Status
from protocol.secret.blocks import ClosedBlock
from runtime.perform import Ports, perform

ORDER: Final = (Tell, Save, Publish, Extract, Notice, Show)


class Asked(NamedTuple):
    """Effects that came in this order, with one save at most."""

    events: tuple[Event, ...] = ()
    save: Save | None = None
    publish: tuple[Message, ...] = ()
    tasks: tuple[ClosedBlock, ...] = ()
    notices: tuple[Notice, ...] = ()
    health: Status | None = None

    @property
    def saved(self) -> Save:
        """The save, which is there."""
        assert self.save is not None
        return self.save

    @property
    def record(self) -> ControllerRecord | PlantRecord | None:
        """The record that is saved, if one is."""
        return None if self.save is None else self.save.record


NOTHING: Final = Asked()


def turns(effects: Effects) -> Iterator[Asked]:
    """The effects in pieces: one ends where the order would go back."""
    asked, last = NOTHING, -1
    for effect in effects:
        place = ORDER.index(type(effect))
        if place < last or (place == last and isinstance(effect, Save | Show)):
            yield asked
            asked = NOTHING
        last = place
        asked = _with(asked, effect)
    if asked != NOTHING:
        yield asked


def gathered(effects: Effects) -> Asked:
    """All of them, and of several saves the last."""
    return reduce(_with, effects, NOTHING)


def _with(asked: Asked, effect: Effect) -> Asked:
    match effect:
        case Tell(event):
            return asked._replace(events=(*asked.events, event))
        case Save():
            return asked._replace(save=effect)
        case Publish(message):
            return asked._replace(publish=(*asked.publish, message))
        case Extract(block):
            return asked._replace(tasks=(*asked.tasks, block))
        case Notice():
            return asked._replace(notices=(*asked.notices, effect))
        case Show(status):
            return asked._replace(health=status)


def hasty(effects: Effects, ports: Ports) -> None:
    """A wrong shell, which sends before it saves."""
    held: list[Effect] = []
    for effect in effects:
        if isinstance(effect, Save):
            held.append(effect)
            continue
        perform([effect], ports)
        if isinstance(effect, Publish):
            perform(held, ports)
            held.clear()
    perform(held, ports)
