"""Carries out the effects of an end, one by one, in the order in which the end gives them.

A step is one save, one message, and then the rest: the end saves what was heard and is about to be
said, publishes it, and counts while its partner works. What was counted is traced, and then saved
with the next step. So a process may die between any two of these lines:

- before the step is saved: nothing was sent, and deciding again does no harm;
- before it is published: the journal has it, and it goes out when it is asked again;
- before it is counted or traced: it is counted, and traced, when the journal is read again;
- before a key block is extracted: its rows are in the journal, and it is asked for again;
- after that: nothing is left to do twice.

The services, the simulation, the tests and the benchmarks come through here. Whoever wants a death
puts it into the ports (:class:`CrashingPorts`): every one of them is called by :func:`perform`
alone. A device is no port; a make-believe one asks :meth:`CrashingPorts.passes` itself.
"""

from typing import Literal, Protocol

from protocol.link.effects import Effects, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import Event
from protocol.messages import Message, Status
from protocol.secret.blocks import ClosedBlock


class Ports(Protocol):
    """Where effects go: journal, bus, trace, log and health file of one end of one loop."""

    def save(self, save: Save) -> None:
        """Save the record and what comes along; it survives what it has to on return."""

    def publish(self, message: Message) -> None:
        """Send it, without waiting for anybody."""

    def trace(self, event: Event) -> None:
        """Write it down for whoever checks the run."""

    def extract(self, block: ClosedBlock) -> None:
        """Have its keys extracted, without waiting for them."""

    def log_notice(self, notice: Notice) -> None:
        """Log it."""

    def health(self, status: Status) -> None:
        """Replace the status in the run's folder."""


def perform(effects: Effects, ports: Ports) -> None:
    """Carry them out."""
    for effect in effects:
        match effect:
            case Save():
                ports.save(effect)
            case Publish(message):
                ports.publish(message)
            case Tell(event):
                ports.trace(event)
            case Extract(block):
                ports.extract(block)
            case Notice():
                ports.log_notice(effect)
            case Show(status):
                ports.health(status)


CrashPoint = Literal["saving", "publishing", "tracing", "extracting", "acting"]
"""The port call at which a simulated process crashes; ``acting`` is a device's, to apply or
read."""


class Crashed(BaseException):
    """A simulated process has crashed, and all but its journal is lost."""


class CrashingPorts:
    """Ports of a simulated process that crashes at the port call which :meth:`crash_at` names.

    Parameters
    ----------
    ports : Ports
        What really happens, up to that point.
    """

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._before: CrashPoint | None = None
        self._left = -1

    def crash_at(self, before: CrashPoint | None = None, after: int = -1) -> None:
        """Crash ``before`` the next call of that kind, or ``after`` so many calls of any kind.

        With both defaults the process does not crash.
        """
        self._before = before
        self._left = after

    def passes(self, point: CrashPoint) -> None:
        """Crash if this is the call, else count it."""
        if point == self._before or self._left == 0:
            raise Crashed
        self._left -= 1

    def save(self, save: Save) -> None:
        """Crash, or save."""
        self.passes("saving")
        self._ports.save(save)

    def publish(self, message: Message) -> None:
        """Crash, or publish."""
        self.passes("publishing")
        self._ports.publish(message)

    def trace(self, event: Event) -> None:
        """Crash, or trace."""
        self.passes("tracing")
        self._ports.trace(event)

    def extract(self, block: ClosedBlock) -> None:
        """Crash, or have it extracted."""
        self.passes("extracting")
        self._ports.extract(block)

    def log_notice(self, notice: Notice) -> None:
        """Log it; no crash happens here."""
        self._ports.log_notice(notice)

    def health(self, status: Status) -> None:
        """Replace the status; no crash happens here."""
        self._ports.health(status)
