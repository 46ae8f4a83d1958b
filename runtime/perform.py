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
has the effects carried out by a :class:`Crashing`. A device is asked for nothing here; a
make-believe one asks :meth:`Crashing.passes` itself.
"""

from collections.abc import Callable
from typing import Final, Literal

from protocol.link.effects import Effect, Effects, Extract, Publish, Save, Tell

Do = Callable[[Effect], None]
"""Carries out one effect of one end of one loop.

A save is on the disk on return, as far as it has to be; publishing and extracting wait for nobody.
"""


def perform(effects: Effects, do: Do) -> None:
    """Carry them out."""
    for effect in effects:
        do(effect)


CrashPoint = Literal["saving", "publishing", "tracing", "extracting", "acting"]
"""What a simulated process was about to do when it crashed; ``acting`` is a device's, to apply or
read."""

POINTS: Final[dict[type[Effect], CrashPoint]] = {
    Save: "saving",
    Publish: "publishing",
    Tell: "tracing",
    Extract: "extracting",
}
"""Effects at which a process may crash. While it logs, or replaces its status, it never does."""


class Crashed(BaseException):
    """A simulated process has crashed, and all but its journal is lost."""


class Crashing:
    """A simulated process, which crashes where :meth:`crash_at` says.

    Parameters
    ----------
    do : callable
        Carries an effect out, up to that point.
    """

    def __init__(self, do: Do) -> None:
        self._do = do
        self._before: CrashPoint | None = None
        self._left = -1

    def crash_at(self, before: CrashPoint | None = None, after: int = -1) -> None:
        """Crash ``before`` the next effect of that kind, or ``after`` so many of any kind.

        With both defaults the process does not crash.
        """
        self._before = before
        self._left = after

    def passes(self, point: CrashPoint) -> None:
        """Crash if this is the point, else count it."""
        if point == self._before or self._left == 0:
            raise Crashed
        self._left -= 1

    def do(self, effect: Effect) -> None:
        """Crash, or carry it out."""
        point = POINTS.get(type(effect))
        if point is not None:
            self.passes(point)
        self._do(effect)
