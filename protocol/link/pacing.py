"""When a step ends and when a measurement is due; time is an argument.

With a deadline each step takes its time: an offer that is applied early waits for the tick, and a
tick without an offer is a missed step. In lock-step (no deadline) a step ends when its offer comes.
"""

from math import inf
from typing import Final, Literal
from zlib import crc32

STATUS_S: Final = 0.05
"""Seconds between two statuses of an end."""

HEALTH_S: Final = 1.0
"""Seconds between two statuses that are kept in the run's folder."""

LOCKSTEP_REPEAT_S: Final = 0.05
"""Seconds between repeats of a measurement where no deadline says otherwise."""


def next_turn(now_s: float, step_s: float, phase: float) -> float:
    """The first time (i + phase) step_s after ``now_s``, i a whole number.

    Adding ``step_s`` to the time of the last run would keep a stall's effect: 200 loops that came
    due together would stay together.
    """
    turn = now_s + step_s - (now_s - phase * step_s) % step_s
    return turn if turn > now_s else turn + step_s  # the remainder may round to a whole step


def phase_of(name: str) -> float:
    """A phase from 0 to 1 by the name's CRC-32: those of many names are spread evenly."""
    return crc32(name.encode()) / 2**32


class Pacing:
    """The plant's clock.

    Parameters
    ----------
    step_s : float or None
        Seconds of wall time in a step; None in lock-step.
    repeats : int
        How often a measurement goes out within a step while no offer comes.
    now_s : float
        The time.
    phase : float, optional
        In a fleet: which part of a step after a whole number of steps ticks come, 0 to 1.

    Attributes
    ----------
    deadline, repeat_at : float
        When the step is over, and when its measurement goes out again.
    late_s : float
        By how much the last tick was noticed late.
    overruns : int
        Ticks that went by unnoticed.
    """

    def __init__(
        self, step_s: float | None, repeats: int, now_s: float, phase: float | None = None
    ) -> None:
        self._step_s = step_s
        self._phase = phase
        self._repeat_s = LOCKSTEP_REPEAT_S if step_s is None else step_s / repeats
        self.deadline = now_s + (step_s or 0.0)
        self.repeat_at = now_s
        self._waiting = False
        self._once = False
        self.late_s = 0.0
        self.overruns = 0

    @property
    def step_s(self) -> float | None:
        """Seconds in a step; None in lock-step."""
        return self._step_s

    @property
    def timed(self) -> bool:
        """Whether a step has a deadline. In lock-step it ends with its offer."""
        return self._step_s is not None

    def since_tick_s(self, now_s: float) -> float:
        """Seconds since the step under way began; 0 in lock-step."""
        return 0.0 if self._step_s is None else now_s - (self.deadline - self._step_s)

    @property
    def waiting(self) -> bool:
        """Whether this step's offer has been applied and its end is awaited."""
        return self._waiting

    def tick(self, now_s: float, *, running: bool) -> Literal["nothing", "ended", "missed"]:
        """Whether the step under way is over, and how it went.

        While the plant is not ``running`` (it never moved and no controller accepted it) the
        deadline moves along with the time. Ticks that a stall of the whole process swallowed are
        not made up for.
        """
        if self._step_s is None:
            return "nothing"
        if not running:
            self.deadline = self._next_tick(now_s, self._step_s)
            return "nothing"
        if now_s < self.deadline:
            return "nothing"
        self.late_s = now_s - self.deadline
        self.overruns += int(self.late_s / self._step_s)
        following = self.deadline + self._step_s
        swallowed = following <= now_s
        self.deadline = self._next_tick(now_s, self._step_s) if swallowed else following
        self.repeat_at = now_s
        was_waiting, self._waiting = self._waiting, False
        return "ended" if was_waiting else "missed"

    def _next_tick(self, now_s: float, step_s: float) -> float:
        """The end of a step that begins at ``now_s``; a phase makes it longer by up to a step."""
        if self._phase is None:
            return now_s + step_s
        return next_turn(now_s, step_s, self._phase) + step_s

    def measurement_due(self, now_s: float) -> bool:
        """Whether to publish the measurement now; if so, the next time is a repeat interval on."""
        if self._waiting or now_s < self.repeat_at:
            return False
        self.repeat_at = inf if self._once else now_s + self._repeat_s
        if self._step_s is not None and self.repeat_at > self.deadline - 0.5 * self._repeat_s:
            self.repeat_at = inf  # as good as the tick, which brings the next one
        return True

    def answered_late(self) -> None:
        """An offer came after its step: the controller is overloaded.

        Until an offer comes in time, each measurement is sent once: repeats would add to the load.
        """
        self._once = self._step_s is not None

    def applied(self) -> None:
        """This step's offer was applied: the next measurement is due at once, or at the tick."""
        self._once = False
        if self._step_s is None:
            self.repeat_at = 0.0
        else:
            self._waiting = True

    def due_at(self, *, running: bool, measuring: bool) -> float:
        """When there is something to do next: a tick of a ``running`` plant, or a measurement."""
        tick = self.deadline if running and self._step_s is not None else inf
        return min(tick, self.repeat_at) if measuring and not self._waiting else tick
