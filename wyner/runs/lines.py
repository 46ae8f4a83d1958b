"""The lines of a trace, each kind with the fields it has: no more, no fewer, of the right type."""

import base64
import binascii
from collections.abc import Sequence, Sized
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic_core import to_json

from protocol.link.distiller import BlockEnded
from protocol.link.events import Alarm, PowerFailed, SessionBegan, Timing
from protocol.link.key_events import Appearances
from protocol.link.session import Rules
from protocol.vectors import Vector
from protocol.wrong_fields import expected_of

STRICT: Final = ConfigDict(extra="forbid", strict=True)

TRANSITION, MISSED, INTERRUPTED = range(3)
"""Kinds of step."""

LARGEST: Final = 2**31 - 1
"""Of a step's number, and every other: what is kept of each has room for no larger one."""

Number = Annotated[int, Field(ge=-LARGEST, le=LARGEST)]
Symbol = Annotated[int, Field(ge=-1, le=LARGEST)]
Index = Annotated[int, Field(ge=0, le=LARGEST)]


@checked_dataclass(frozen=True, slots=True, config=STRICT)
class TracedTransition:
    """A transition as one side's trace holds it; from ``coin`` on the fields are the plant's alone.

    ``box`` is where the state lay before it, low and high, where some outputs alone are read.

    ``digits`` is the position in the key stream that the offer named, if any, and ``keyed`` whether
    its digits served; ``expected`` is the controller's alone. The last three are there where the
    plant is attacked.
    """

    # A model would take three times the room, and a run has millions.

    event: Literal["transition"]
    session: str
    j: Number
    k: Number
    x: Vector
    candidates: tuple[Vector, ...]
    cipher: Index
    x_next: Vector
    role: Literal["test", "message"]
    gauges: Vector
    symbol: Symbol
    key: Symbol
    message_symbol: Symbol
    p: Number
    s: Number
    counts: Annotated[int, Field(ge=0, le=3)]
    predictions: tuple[Vector, ...] = ()
    box: tuple[Vector, Vector] | None = None
    digits: tuple[Index, Index] | None = None
    keyed: bool = False
    expected: Symbol = -1
    coin: Index | None = None
    u: Vector | None = None
    true_x_next: Vector | None = None
    true_u: Vector | None = None
    attack_failed: str = ""

    kind: ClassVar = TRANSITION

    @property
    def message(self) -> bool:
        """Whether it carried a symbol, and tested nothing."""
        return self.role == "message"

    @property
    def block(self) -> int:
        """The block of the key stream that the offer named; -1 where it named none."""
        return self.digits[0] if self.digits else -1

    @property
    def at(self) -> int:
        """The number in that block."""
        return self.digits[1] if self.digits else 0


@checked_dataclass(frozen=True, slots=True, config=STRICT)
class MissedLine:
    """A step without a counted offer, as the plant's trace holds it.

    An ``interrupted`` one was under way when the plant's process died or its session ended;
    ``candidates`` and ``coin`` are of an offer that it had begun to apply.
    """

    event: Literal["missed", "interrupted"]
    session: str
    k: Number
    x: Vector
    u: Vector
    x_next: Vector
    candidates: tuple[Vector, ...] = ()
    coin: Symbol = -1
    true_x_next: Vector | None = None
    true_u: Vector | None = None
    attack_failed: str = ""

    @property
    def kind(self) -> int:
        """Whether the plant's process died over it, or its session ended."""
        return INTERRUPTED if self.event == "interrupted" else MISSED


class QueuedLine(NamedTuple):
    """A message was handed to the controller, or every symbol of it was counted there."""

    id: str
    payload: str


class RecoveredLine(NamedTuple):
    """A whole frame passed its check at the plant."""

    payload: str


class Refused(NamedTuple):
    """A frame failed its check at the plant."""

    session: str
    p: int


class AttackLine(NamedTuple):
    """The plant is attacked: every parameter."""

    kind: str
    at: Literal["sensor", "bus", "actuator"]
    onset: int
    knows: tuple[str, ...]
    options: dict[str, Any]


EventLine = (
    SessionBegan
    | QueuedLine
    | RecoveredLine
    | Refused
    | BlockEnded
    | Appearances
    | Alarm
    | Timing
    | AttackLine
    | PowerFailed
)

_BOTH: Final[dict[str, Any]] = {
    "transition": TracedTransition,
    "session": SessionBegan,
    "block": BlockEnded,
    "appearances": Appearances,
    "power_failed": PowerFailed,
}

EVENTS: Final[dict[str, dict[str, Any]]] = {
    "plant": _BOTH
    | dict.fromkeys(("missed", "interrupted"), MissedLine)
    | {"timing": Timing, "attack": AttackLine, "recovered": RecoveredLine, "refused": Refused},
    "controller": _BOTH | {"alarm": Alarm} | dict.fromkeys(("sent", "delivered"), QueuedLine),
}
"""What each side may trace, and the type of its line."""

_TRANSITION: Final = TypeAdapter(TracedTransition)
_MISSED: Final = TypeAdapter(MissedLine)
_OTHERS: Final[dict[str, TypeAdapter[EventLine]]] = {
    event: TypeAdapter(kind, config=ConfigDict(strict=True))
    for kinds in EVENTS.values()
    for event, kind in kinds.items()
    if kind not in (TracedTransition, MissedLine)
}


def read_transition(raw: bytes) -> TracedTransition:
    """A line of a transition.

    Raises
    ------
    pydantic.ValidationError
        When it is not as it must be.
    """
    return _TRANSITION.validate_json(raw)


def read_line(raw: bytes, value: dict[str, Any]) -> EventLine | MissedLine:
    """Another line, whose JSON object is ``value``.

    Raises
    ------
    ValueError
        When it is not as it must be.
    """
    event = value["event"]
    if event not in _OTHERS:
        return _MISSED.validate_json(raw)
    fields = {name: one for name, one in value.items() if name != "event"}
    line = _OTHERS[event].validate_json(to_json(fields))
    for name in line._fields:
        if name not in fields:
            raise ValueError(f"{name}: expected, and there is none")
    return line


class OtherLine(NamedTuple):
    """Another line of a trace.

    ``payload`` is its message, where it has one; ``again`` says that the report had been written
    before, and so had its transition.
    """

    event: str
    line: EventLine
    payload: bytes
    again: bool = False


class Again(NamedTuple):
    """A transition that was written a second time, after a restart."""

    before: TracedTransition
    after: TracedTransition


class Break(NamedTuple):
    """The writer's process is over; ``ended`` says that it ended by itself, and was not killed."""

    ended: bool


Item = OtherLine | Again | Break

_SYMBOLS: Final = ("cipher", "symbol", "key", "message_symbol", "expected", "coin")


class Shape(NamedTuple):
    """The sizes of the plant: numbers of a reading, inputs, candidates; and states, where those
    are read through some outputs alone.
    """

    n: int
    m: int
    size: int
    hidden: int = 0

    @classmethod
    def of(cls, rules: Rules) -> "Shape":
        """That of a scenario's rules."""
        hidden = 0 if rules.outputs is None else len(rules.outputs.observer.A)
        return cls(rules.states, rules.inputs, rules.size, hidden)

    def unlike(self, t: TracedTransition, *, plant: bool) -> str:
        """The first field of ``t`` that is not of this shape; empty where all are."""
        n, m, size, hidden = self
        for name in _SYMBOLS:
            if (getattr(t, name) or 0) >= size:
                return f"{name}: got {getattr(t, name)}, expected less than {size}"
        if (t.box is not None) != bool(hidden):
            return f"box: expected {'one' if hidden else 'none'}"
        own = (t.coin is not None, t.u is not None)
        if own != (plant, plant) or (t.true_u is not None and not plant):
            return "coin, u, true_u: expected in the plant's trace, and there alone"
        if plant and t.expected != -1:
            return "expected: only in the controller's trace"
        return _unlike_lengths(
            ("x", [t.x], n),
            ("x_next", [t.x_next], n),
            ("candidates", [t.candidates], size),
            ("candidates", t.candidates, m),
            ("gauges", [t.gauges], size),
            ("box", t.box or (), hidden),
            ("u", [t.u] if t.u is not None else (), m),
        ) or self._unlike_truth(t)

    def _unlike_truth(self, step: "TracedTransition | MissedLine") -> str:
        x, u = step.true_x_next, step.true_u
        if x is None and u is None:
            return ""
        if x is None or u is None:
            return "true_x_next, true_u: expected both or none"
        return _unlike_lengths(("true_x_next", [x], self.hidden or self.n), ("true_u", [u], self.m))

    def unlike_missed(self, step: MissedLine) -> str:
        """The same of a missed step."""
        if step.event == "missed" and (step.candidates or step.coin != -1):
            return "candidates, coin: expected of an interrupted step only"
        if step.candidates and not 0 <= step.coin < self.size:
            return f"coin: got {step.coin}, expected 0 to {self.size - 1}"
        return _unlike_lengths(
            ("x", [step.x], self.n),
            ("x_next", [step.x_next], self.n),
            ("u", [step.u], self.m),
            ("candidates", [step.candidates] if step.candidates else (), self.size),
            ("candidates", step.candidates, self.m),
        ) or self._unlike_truth(step)


def _unlike_lengths(*named: tuple[str, Sequence[Sized], int]) -> str:
    """The first field of which some vector is not as long as it must be; empty where all are."""
    for name, vectors, length in named:
        for one in vectors:
            if len(one) != length:
                return f"{name}: got {len(one)} of them, expected {length}"
    return ""


def wrong(error: ValidationError) -> str:
    """A validation error in a line."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    path = ".".join(str(part) for part in first["loc"])
    said = expected_of(first)
    return f"{path}: {said}" if path else said


def payload_of(line: EventLine) -> bytes:
    """The message that a line holds.

    Raises
    ------
    ValueError
        When it is no base64.
    """
    if not isinstance(line, QueuedLine | RecoveredLine):
        return b""
    try:
        return base64.b64decode(line.payload, validate=True)
    except binascii.Error:
        raise ValueError("payload: expected base64") from None
