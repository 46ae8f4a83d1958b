"""One end by itself, with all that it ever asked its shell to do."""

from typing import Any, Generic, TypeVar

from protocol.link.peer import Actions, Peer
from protocol.messages import Message

E = TypeVar("E", bound=Peer)


class EndInHand(Generic[E]):
    """An end whose test is its shell, and keeps every :class:`Actions`.

    Parameters
    ----------
    core : ControllerCore or PlantCore
    """

    def __init__(self, core: E) -> None:
        self.core = core
        self.all: list[Actions] = []

    def carry_out(self, actions: Actions) -> None:
        """What the shell does besides; nothing here."""

    def does(self, actions: Actions) -> Actions:
        """What a shell does with the actions, and with those after them; the first ones."""
        first = actions
        while True:
            self.all.append(actions)
            assert all(notice.text for notice in actions.notices)
            self.carry_out(actions)
            if not actions.finish_step:
                return first
            actions = self.core.finish_step()

    def hears(self, message: Message, now: float) -> Actions:
        return self.does(self.core.receive(type(message), message.wire(), now))

    def wakes(self, now: float) -> Actions:
        return self.does(self.core.wake(now))

    @property
    def notices(self) -> list[tuple[str, str]]:
        """Level and subject of all that was said so far; forgotten afterwards."""
        said: list[tuple[str, str]] = [
            (n.level, n.subject) for actions in self.all for n in actions.notices
        ]
        self.all.clear()
        return said


def kept(actions: Actions) -> Actions:
    """What of the actions is saved, and nothing else."""
    return actions._replace(
        events=(), publish=(), notices=(), health=None, finish_step=False, tasks=()
    )


def fields(status: Message) -> dict[str, Any]:
    """All of a status but version, number and hour."""
    said = status.model_dump()
    del said["v"], said["seq"], said["t_ns"]
    return said
