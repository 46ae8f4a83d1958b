"""Both real endpoints and the one shell, on a network that can be made to lose nothing.

It judges nothing: what an unreliable network may do to the link is tried in
:mod:`tests.campaigns.space`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from protocol.agreement import NO_SYMBOL
from protocol.link.events import Event
from protocol.link.peer import Actions, Notice
from protocol.link.session import CountedTransition
from protocol.messages import Offer
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal
from runtime.perform import perform
from tests.campaigns.end import LONG_S
from tests.campaigns.loop import propose, rules_of
from tests.support.line_ends import LinePlant, ToldPorts, line_controller, line_plant
from tests.support.mail import Mail

REMEMBERED = 2
"""Messages of each direction that are on their way at most."""

PAYLOAD = b"a"


def quiet(_notice: Notice) -> None:
    """Nobody reads the log."""


@dataclass
class World:
    """The whole system.

    Parameters
    ----------
    scheme : str
        ``switched`` or ``pipelined``.
    step_s : float, optional
        A deadline each step, so that steps are missed; None for lock-step.
    """

    scheme: str
    step_s: float | None = None
    names: int = 0
    now: float = 0.0
    to_plant: list[Mail] = field(default_factory=list)
    to_controller: list[Mail] = field(default_factory=list)
    sent: dict[tuple[str, int], CountedTransition] = field(default_factory=dict)
    got: dict[tuple[str, int], CountedTransition] = field(default_factory=dict)
    plant: PlantCore = field(init=False)
    line: LinePlant = field(init=False)
    controller: ControllerCore = field(init=False)

    def __post_init__(self) -> None:
        self.controller_journal = MemoryControllerJournal(PAYLOAD)
        self.plant_journal = MemoryPlantJournal()
        self._controller_ports = ToldPorts(
            self.controller_journal, self._controller_said, self._counted, quiet
        )
        self._plant_ports = ToldPorts(self.plant_journal, self._plant_said, self._counted, quiet)
        rules = rules_of(self.scheme, keys=False)
        self.controller = line_controller(
            rules, propose, self.controller_journal, self, self.name()
        )
        self._perform(self.controller, self.controller.start(self.now))
        self.plant, self.line = line_plant(
            rules, self.plant_journal, self.name, self.name(), self.now, self.step_s
        )
        self._perform(self.plant, self.plant.start(self.now))

    def symbol(self, transition: int, size: int) -> int:
        """A cover symbol."""
        return transition % size

    def name(self) -> str:
        """A new id."""
        self.names += 1
        return f"{self.names:016x}"

    def _controller_said(self, message: Mail) -> None:
        self._remember(self.to_plant, message)

    def _plant_said(self, message: Mail) -> None:
        self._remember(self.to_controller, message)

    def _remember(self, where: list[Mail], message: Mail) -> None:
        if message in where:
            where.remove(message)
        where.append(message)
        del where[:-REMEMBERED]

    def _counted(self, event: Event) -> None:
        if isinstance(event, CountedTransition):
            counted = self.sent if event.coin == NO_SYMBOL else self.got
            counted[event.session, event.j] = event.shared

    def _perform(self, endpoint: ControllerCore | PlantCore, actions: Actions) -> None:
        mine = isinstance(endpoint, PlantCore)
        perform(actions, endpoint, self._plant_ports if mine else self._controller_ports)

    def goes_on(self, events: int = 400) -> bool:
        """Whether a message symbol comes through once nothing is lost; the world is used up."""
        self.to_plant.clear()
        self.to_controller.clear()
        carried = self._carried()
        return self._all_is_well(lambda: self._carried() > carried, events)

    def warm_up(self) -> None:
        """Let both ends meet and count two transitions."""
        assert self._all_is_well(lambda: len(self.sent) >= 2, 400)

    def _all_is_well(self, over: Callable[[], bool], events: int) -> bool:
        offers = 0
        for _ in range(events):
            if self.to_plant:
                message = self.to_plant.pop(0)
                offers += message.kind is Offer
                self.line.coin, self.line.d = offers % 2, 0.3
                self._perform(self.plant, self.plant.receive(*message, self.now))
            elif self.to_controller:
                message = self.to_controller.pop(0)
                self._perform(self.controller, self.controller.receive(*message, self.now))
            else:
                self.now = max(self.now, min(self.plant.wake_at(), self.now + LONG_S))
                self._perform(self.plant, self.plant.wake(self.now))
            if over():
                return True
        return False

    def _carried(self) -> int:
        return sum(t.role == "message" for t in self.got.values())
