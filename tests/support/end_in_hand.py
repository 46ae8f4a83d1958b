"""One end by itself, with all that it ever asked its shell to do."""

from typing import Any, Generic, TypeVar

from protocol.link.effects import Effects
from protocol.link.endpoint import Endpoint
from protocol.messages import Message, Status
from tests.support.asked import NOTHING, Asked, turns

E = TypeVar("E", bound=Endpoint)


class EndInHand(Generic[E]):
    """An end whose test is its shell, and keeps every :class:`Asked`.

    Parameters
    ----------
    core : ControllerCore or PlantCore
    """

    def __init__(self, core: E) -> None:
        self.core = core
        self.all: list[Asked] = []

    def carry_out(self, asked: Asked) -> None:
        """What the shell does besides; nothing here."""

    def does(self, effects: Effects) -> Asked:
        """What a shell does with the effects; the first of them that belong together."""
        done = []
        for asked in turns(effects):
            done.append(asked)
            assert all(notice.text for notice in asked.notices)
            self.carry_out(asked)
        self.all += done
        return done[0] if done else NOTHING

    def hears(self, message: Message, now: float) -> Asked:
        return self.does(self.core.receive(type(message), message.wire(), now))

    def wakes(self, now: float) -> Asked:
        return self.does(self.core.wake(now))

    @property
    def notices(self) -> list[tuple[str, str]]:
        """Level and subject of all that was said so far; forgotten afterwards."""
        said: list[tuple[str, str]] = [
            (n.level, n.subject) for actions in self.all for n in actions.notices
        ]
        self.all.clear()
        return said


class Zeros:
    """Symbols that are no secret."""

    def symbol(self, transition: int, size: int) -> int:
        return 0


def status_of(core: Endpoint, now: float | None = None, **more: Any) -> Any:
    """The status of an end, at ``now``."""
    state = core.state
    state.now = state.now if now is None else now
    return core.news.status(state, core.malformed, **more)


def fields(status: Message) -> dict[str, Any]:
    """All of a status but version, number and hour."""
    said = status.model_dump()
    del said["v"], said["seq"], said["t_ns"]
    return said


def unsaid(kind: type[Status]) -> dict[str, Any]:
    """What a status says by default, of all that it need not say."""
    of = kind.model_fields.items()
    return {name: f.default for name, f in of if not f.is_required() and name != "v"}
