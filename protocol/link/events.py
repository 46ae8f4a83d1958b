"""What a side traces: one class an event, which says itself how it reads in a trace.

A transition is :class:`protocol.link.session.CountedTransition`, a message that was queued its
:class:`protocol.messages.SendCommand`.
"""

from typing import Any, Final, Literal, NamedTuple, Protocol

from protocol.link.session import CountedTransition, TrueStep
from protocol.vectors import Vector

NEW_JOURNAL: Final = "new journal"
"""Why the first session of a journal begins: the plant counts its steps from 0."""

RESUMED: Final = "resumed from the journal"
"""Why a session that was there before goes on."""

UNKNOWN_THERE: Final = "the controller does not know the session before"
BLOCKS_DIFFER: Final = "a key block differs from the other end's"
MET: Final = "the plant began it"
DOES_NOT_FOLLOW: Final = "a measurement does not follow from the journal"
ELSEWHERE: Final = "the plant is with another controller"

FELL_BACK: Final = "the machine was started again, and the newest steps may be lost"
"""Why a session ends after a power failure."""

REASONS: Final = {
    "plant": (NEW_JOURNAL, RESUMED, UNKNOWN_THERE, BLOCKS_DIFFER, FELL_BACK),
    "controller": (MET, DOES_NOT_FOLLOW, BLOCKS_DIFFER, ELSEWHERE, FELL_BACK),
}
"""All that a side may trace of why a session begins or ends there."""


class Event(Protocol):
    """Something that happened at one side."""

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace, by the names in :mod:`runtime.recording`."""


def lines(event: Event) -> tuple[dict[str, Any], ...]:
    """An event as it stands in a trace: a transition's report is a line of its own."""
    report = event.report() if isinstance(event, CountedTransition) else None
    return (event.as_event(),) if report is None else (event.as_event(), report)


class SessionBegan(NamedTuple):
    """A session began, was resumed, or was given up; ``reason`` says why."""

    session: str | None
    reason: str

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "session", "session": self.session, "reason": self.reason}


class PowerFailed(NamedTuple):
    """This process began with a journal that another boot of the machine had not closed.

    Lines that were traced before may be lost, since not every one of them was synced.
    """

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "power_failed"}


class AttackBegan(NamedTuple):
    """The plant is attacked: ``kind``, ``at``, ``onset`` and the attack's own, for who judges."""

    attack: dict[str, Any]

    def sentence(self) -> str:
        """Who, where and from when on."""
        at = {"sensor": "at the sensor", "bus": "on the bus", "actuator": "at the actuator"}
        return f"{self.attack['kind']} {at[self.attack['at']]} from step {self.attack['onset']}"

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "attack", **self.attack}


class Missed(NamedTuple):
    """A step without an offer: the fallback input was in force."""

    session: str
    k: int
    x: Vector
    u: Vector
    x_next: Vector
    truth: TrueStep | None = None

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "missed", **_labelled(self._asdict())}


class Interrupted(NamedTuple):
    """A step that counts as missed, since it was under way when something ended.

    Either the plant's process died, and x_next is what it read when it was back; or its session
    ended, and x_next is what it read at the end of the step. ``session`` is the one in which the
    plant went on. ``candidates`` and ``coin`` are those of an offer that it had begun to apply
    (else empty and -1). Whether ``u``, the one chosen, was applied is not known after a death.
    """

    session: str
    k: int
    x: Vector
    u: Vector
    x_next: Vector
    candidates: tuple[Vector, ...] = ()
    coin: int = -1
    truth: TrueStep | None = None

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "interrupted", **_labelled(self._asdict())}


Reason = Literal["", "unexplained", "another candidate", "digits refused", "unwatched"]
"""Why a transition makes an alarm; empty: it makes none."""


class Alarm(NamedTuple):
    """A transition makes an alarm at the controller.

    ``reading`` is x(k+1) as it was reported. ``expected`` is the prediction for ``candidate``, and
    ``gauge`` how far the reading is from it, in D_c. The candidate is the one that a digit of the
    key stream chose, or, where none did, the nearest one. ``reason``: ``unexplained``, no candidate
    explains the reading; ``another candidate``, not the one that the digit chose; ``digits
    refused``, the plant denies digits that it holds; ``unwatched``, too many steps had no digit.
    This one may come with a session's first reading, before there is a transition (j = -1): of the
    last step of the session before nobody has heard.
    """

    session: str
    j: int
    k: int
    reading: Vector
    reason: Reason
    candidate: int
    expected: Vector
    gauge: float

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "alarm", **self._asdict()}

    def sentence(self) -> str:
        """As a line of the log."""
        if self.reason == "unwatched":
            return f"ALARM at step {self.k}: too many steps had no digit of the key stream"
        if self.reason == "digits refused":
            return f"ALARM at step {self.k}: the plant denies digits of the key stream that it has"
        whose = f"candidate {self.candidate}, which the key stream chose"
        if self.reason == "unexplained":
            whose = f"the nearest of all candidates, {self.candidate}"
        read, expected = (", ".join(f"{v:.4g}" for v in x) for x in (self.reading, self.expected))
        return (
            f"ALARM at step {self.k}: read ({read}), expected ({expected}) within D_c, by {whose}; "
            f"it is {self.gauge:.3g} times as far"
        )


class Timing(NamedTuple):
    """How punctual a plant was, of its last steps: (median, 99th percentile, largest), seconds.

    ``sampled_late_s`` after the tick, ``actuated_after_s`` after the step began; ``overruns``
    counts ticks that went by unnoticed.
    """

    k: int
    steps: int
    sampled_late_s: Vector
    actuated_after_s: Vector
    overruns: int

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "timing", **self._asdict()}


def _labelled(fields: dict[str, Any]) -> dict[str, Any]:
    """The fields, with those of the truth in place of it."""
    truth: TrueStep | None = fields.pop("truth")
    return fields if truth is None else fields | truth.fields()
