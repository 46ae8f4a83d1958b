"""Management messages: of controller, plant, dashboard and operator; the tap must not hear them."""

import base64
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from protocol.messages.base import (
    BLOCKS_LOST,
    DIGITS_LEFT,
    KEYS_MADE,
    KEYS_STOPPED,
    MALFORMED,
    Count,
    Fingerprint,
    Identifier,
    Message,
    Metric,
    SessionId,
)
from protocol.vectors import FiniteVector


class PlantHello(Message):
    """The plant asks a controller to take up a session, and repeats it until it is answered.

    Attributes
    ----------
    instance : str
        The plant's process.
    session : str
        The session to take up.
    controller : str or None
        The controller process that is asked; every other one learns that the session is not its
        own. None: the plant looks for a controller, and asks the next one that greets.
    incarnation : int
        That of the controller asked last, as it greeted.
    fingerprint : str
        SHA-256 of what both ends must share; with another one there is no session.
    transitions, applied_k : int
        Transitions that the plant has counted in the session, and the step of its last applied
        offer (-1: none).
    """

    topic: ClassVar[str] = "management/plant/hello"
    instance: SessionId
    session: SessionId
    controller: SessionId | None = None
    incarnation: Count
    fingerprint: Fingerprint
    transitions: Count
    applied_k: Annotated[int, Field(ge=-1)]


class ControllerHello(Message):
    """The controller's answer to a plant's hello, or its greeting after a start.

    Attributes
    ----------
    instance : str
        The controller's process.
    incarnation : int
        Number of processes that have opened this controller's journal. The newest one counts.
    fingerprint : str
        As in `PlantHello`.
    verdict : {"greeting", "accepted", "unknown-session", "other-model"}
        What it says: a greeting, or one of the three answers.
    session : str or None
        Greeting: the session of its journal. Answer: the session that it was asked for.
    answers : str or None
        Answer: the plant's process.
    """

    topic: ClassVar[str] = "management/controller/hello"
    instance: SessionId
    incarnation: Count
    fingerprint: Fingerprint
    verdict: Literal["greeting", "accepted", "unknown-session", "other-model"]
    session: SessionId | None = None
    answers: SessionId | None = None


class SendCommand(Message):
    """An operator's message for the controller to deliver. An ``id`` is queued once."""

    topic: ClassVar[str] = "management/command/send"
    id: Identifier
    payload: bytes

    model_config = ConfigDict(ser_json_bytes="base64", val_json_bytes="base64")

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace: it was queued."""
        payload = base64.b64encode(self.payload).decode()
        return {"event": "sent", "id": self.id, "payload": payload}


class SendReply(Message):
    """The controller's answer to a `SendCommand`."""

    topic: ClassVar[str] = "management/reply/send"
    id: Identifier
    accepted: bool
    queued: Count
    detail: str = ""


class StopKeys(Message):
    """Whoever watches a run to the controller: the claim that keys rest on is refuted.

    Attributes
    ----------
    reason : str
        In words; it is logged, and stands in the status.
    """

    topic: ClassVar[str] = "management/command/stop-keys"
    reason: Annotated[str, StringConstraints(min_length=1, max_length=200)]


_Rows = Annotated[tuple[FiniteVector, ...], Field(min_length=1)]


def _alike(rows: Iterable[tuple[float, ...]]) -> bool:
    """Whether all have one length."""
    return len({len(row) for row in rows}) <= 1


LATENCY_BOUNDS_S: Final = (
    0.0005,
    0.001,
    0.0015,
    0.002,
    0.003,
    0.004,
    0.005,
    0.006,
    0.008,
    0.01,
    0.015,
    0.02,
    0.03,
    0.05,
    0.075,
    0.1,
    0.2,
    0.5,
    1.0,
)
"""Upper bounds of the bins of `PlantStatus.latency_counts`, in seconds."""


class PlantModel(Message):
    """What does not change while a plant's process lives, for the dashboard.

    It travels right before the first status, and again every few seconds for late viewers.

    Attributes
    ----------
    scenario, law, pace : str
        Names.
    seeded : bool
        Draws are predictable, so the run's keys are for nobody.
    period_s : float
        Length of a step, in seconds.
    alpha : float
        D_e = alpha D_c, unless ``eavesdropper_H`` is given.
    A, B : tuple of tuple of float
        The controller's f_c(x, u) = A x + B u, shapes (n, n) and (n, m).
    defender_H, defender_h
        D_c = {d : H d <= h}.
    eavesdropper_H, eavesdropper_h
        D_e likewise where it has a shape of its own; else empty.
    keys_claim : str
        The claim under which keys are secret, in words; empty where none are made.
    keys_eps : float
        How far from perfect each key block that is begun may be; 0 where none are made.
    """

    topic: ClassVar[str] = "management/plant/model"
    scenario: str
    law: str
    pace: str
    seeded: bool
    period_s: float
    alpha: float
    defender_H: _Rows
    defender_h: FiniteVector
    A: _Rows
    B: _Rows
    keys_claim: str = ""
    keys_eps: float = 0.0
    eavesdropper_H: tuple[FiniteVector, ...] = ()
    eavesdropper_h: FiniteVector = ()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        n = len(self.A)
        if (
            any(len(row) != n for row in (*self.A, *self.defender_H, *self.eavesdropper_H))
            or len(self.eavesdropper_h) != len(self.eavesdropper_H)
            or len(self.B) != n
            or not _alike(self.B)
            or len(self.defender_h) != len(self.defender_H)
        ):
            raise ValueError("expected matrices that fit together")
        return self


SECRET_FIELDS: Final = frozenset({"last_message", "partial", "sending"})
SECRET_PREFIXES: Final = ("tail_", "pictured_")
"""Fields that travel on the management bus only, in no file: texts, the last keys and coins."""


class _Status(Message):
    """What one end of the loop knows. It is published at a bounded rate; the newest wins.

    The ends build theirs by ``model_construct``, which takes a quarter of the time of validation;
    tests validate what they publish.

    Attributes
    ----------
    transitions, agreements : int
        Transitions of the session; key symbols agreed on.
    malformed, unexplained : int
        Messages that could not be read; transitions that no candidate explains.
    automaton : int
        The scheme's state s.
    frame_symbols, frame_length : int
        Symbols so far of the frame under way, and in all.
    keys_made, key_blocks_lost : int
        Keys of confirmed blocks, and blocks that made none, since this process began.
    keys_of_block, key_block_steps : int
        Keys and steps of the last confirmed block.
    keys_refused : str
        Why no key is made any more; empty while some are.
    keys_stopped : str
        Why the session's newest block made no key; empty once a later one has made some.
    digits_left : int
        Digits of the key stream that this end holds.
    appearances : int
        How often a message leaves this end on the field bus.
    """

    seq: Count
    t_ns: Count
    phase: str
    detail: str = ""
    transitions: Count
    malformed: Annotated[Count, MALFORMED]
    agreements: Annotated[
        Count, Metric("agreements", "transitions on which a key symbol was agreed")
    ]
    automaton: Count
    frame_symbols: Count
    frame_length: Count
    unexplained: Count = 0
    keys_made: Annotated[Count, KEYS_MADE] = 0
    keys_of_block: Count = 0
    key_block_steps: Count = 0
    keys_refused: str = ""
    keys_stopped: Annotated[str, KEYS_STOPPED] = ""
    key_blocks_lost: Annotated[Count, BLOCKS_LOST] = 0
    digits_left: Annotated[Count, DIGITS_LEFT] = 0
    appearances: Count = 1

    def on_file(self) -> bytes:
        """The status as a file may keep it, without `SECRET_FIELDS` and `SECRET_PREFIXES`."""
        return self.__pydantic_serializer__.to_json(self, exclude=_withheld(type(self)))


@cache
def _withheld(kind: type[_Status]) -> set[str]:
    return {
        name
        for name in kind.model_fields
        if name in SECRET_FIELDS or name.startswith(SECRET_PREFIXES)
    }


class PlantStatus(_Status):
    """What the plant knows, for the dashboard.

    Attributes
    ----------
    k, x : int, tuple of float
        The step, and the state x(k), n numbers.
    symbol_errors : int
        Key symbols agreed on that are not the coin.
    missed, late : int
        Steps without an offer in time; offers after their step.
    outside : int
        Transitions whose disturbance left D_c.
    rate_hz : float
        Transitions a second, over the last few seconds.
    last_message, message_k : str, int
        The last whole message, and the step at which it was whole (-1: none by this process).
    partial : str
        The text so far of the frame under way.
    latency_counts : tuple of int
        Offers by the seconds from a step's first measurement to its offer: a bin for each bound of
        `LATENCY_BOUNDS_S`, not cumulative, and one above them.
    sampled_late_s, actuated_after_s : tuple of float
        Median, 99th percentile and largest of the last steps, in seconds; empty in lock-step.
    key_blocks_begun : int
        Blocks begun by all incarnations. Each adds ``eps_sec`` to the distance from perfect keys,
        whatever became of it.
    pictured_k, pictured_x, pictured_candidates, pictured_x_next, pictured_gauges, pictured_symbol
        One transition, to be drawn in the plane as in the paper's Fig. 4; ``pictured_k`` is -1
        where there is none.
    pictured_inside : int
        Candidates that explain it within D_c.
    tail_k, tail_x, tail_role, tail_symbol, tail_coin, tail_automaton : tuple
        The last transitions, oldest first: those since the last status but one, 8 to 64; 64 after a
        `PlantModel`. The role is ``message`` where the transition carried a message symbol, else
        ``test``. The symbol is -1 where none was agreed on. The coin is the applied candidate b_r.
        The automaton's state is that after the transition.
    attack, true_x, tail_true_x : str, tuple of float, tuple
        Of an attacked plant: what attacks it, and its true states at x(k) and after each transition
        of the tail. They say so to whoever watches; no end acts on it.
    """

    topic: ClassVar[str] = "management/plant/status"
    phase: Literal["greeting", "running", "stopped", "refused"]
    session: SessionId
    sessions: Count
    k: Annotated[Count, Metric("steps", "steps that the plant made, missed ones too")]
    x: FiniteVector
    missed: Annotated[Count, Metric("missed_steps", "steps without an offer in time")]
    late: Annotated[Count, Metric("late_offers", "offers that came after their step")]
    symbol_errors: Annotated[
        Count, Metric("symbol_errors", "agreements on a symbol that was not applied")
    ]
    rate_hz: float
    recovered_symbols: Count
    messages: Annotated[Count, Metric("messages_recovered", "whole messages that the plant has")]
    last_message: str = ""
    message_k: Annotated[int, Field(ge=-1)] = -1
    latency_counts: tuple[Count, ...] = ()
    partial: str = ""
    frames_refused: Annotated[Count, Metric("frames_refused", "frames that failed their check")]
    outside: Count = 0
    sampled_late_s: FiniteVector = ()
    actuated_after_s: FiniteVector = ()
    overruns: Count = 0
    key_blocks_begun: Count = 0
    pictured_k: Annotated[int, Field(ge=-1)] = -1
    pictured_x: FiniteVector = ()
    pictured_candidates: tuple[FiniteVector, ...] = ()
    pictured_x_next: FiniteVector = ()
    pictured_gauges: FiniteVector = ()
    pictured_symbol: Annotated[int, Field(ge=-1)] = -1
    pictured_inside: Count = 0
    tail_k: tuple[int, ...] = ()
    tail_x: tuple[FiniteVector, ...] = ()
    tail_role: tuple[Literal["test", "message"], ...] = ()
    tail_symbol: tuple[int, ...] = ()
    tail_coin: tuple[int, ...] = ()
    tail_automaton: tuple[int, ...] = ()
    attack: str = ""
    true_x: FiniteVector = ()
    tail_true_x: tuple[FiniteVector, ...] = ()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        n = len(self.x)
        tails = (self.tail_k, self.tail_x, self.tail_role, self.tail_symbol, self.tail_coin)
        states = (*self.tail_x, *self.tail_true_x)
        if self.true_x:
            states = (*states, self.true_x)
        if self.pictured_k >= 0:
            states = (*states, self.pictured_x, self.pictured_x_next)
        if (
            any(len(tail) != len(self.tail_automaton) for tail in tails)
            or len(self.tail_true_x) not in (0, len(self.tail_k))
            or any(len(row) != n for row in states)
            or not _alike(self.pictured_candidates)
            or len(self.pictured_gauges) != len(self.pictured_candidates)
            or len(self.latency_counts) not in (0, len(LATENCY_BOUNDS_S) + 1)
        ):
            raise ValueError("expected vectors that fit together")
        return self


class ControllerStatus(_Status):
    """What the controller knows, for the dashboard.

    ``session`` and ``k`` are those of `PlantStatus`.

    Attributes
    ----------
    set_index : int
        i(k), the smallest i with x(k) in T_i; -1: in none.
    sending : str
        The text on its way. When all is sent it keeps the last one, and ``frame_symbols`` equals
        ``frame_length``.
    queue, delivered : int
        Messages that wait behind it, and those of which every symbol was counted.
    unexplained, watched, unwatched : int
        Transitions since this process began that no candidate explains; those that were tested
        against the one candidate that a digit of the key stream chose; and, where the coin is
        keyed, those that could not be.
    alarms, alarm_k : int
        Alarms since this process began, and the step of the last one (-1: none).
    alarm_reading, alarm_expected, alarm_gauge : tuple of float, tuple of float, float
        What was read after that step, what was expected, and how far apart they are, in D_c.
        Nothing is expected where too many steps had no digit of the key stream.
    """

    topic: ClassVar[str] = "management/controller/status"
    phase: Literal["greeting", "running", "outside", "alarmed", "stopped", "refused"]
    session: SessionId | None
    k: Annotated[int, Field(ge=-1)]
    set_index: Annotated[int, Field(ge=-1)]
    sending: str = ""
    queue: Count
    delivered: Annotated[
        Count, Metric("messages_delivered", "messages of which every symbol was counted")
    ]
    watched: Annotated[
        Count, Metric("watched_steps", "transitions tested by a key's candidate")
    ] = 0
    unwatched: Annotated[
        Count, Metric("unwatched_steps", "transitions that no key watched, of a keyed coin")
    ] = 0
    alarms: Annotated[
        Count, Metric("alarms", "transitions whose test failed and made an alarm")
    ] = 0
    alarm_k: Annotated[int, Field(ge=-1)] = -1
    alarm_reading: FiniteVector = ()
    alarm_expected: FiniteVector = ()
    alarm_gauge: float = 0.0

    def alarm_sentence(self) -> str:
        """The alarms and the last one, in words; empty where there is none."""
        if not self.alarms:
            return ""
        read, expected = (
            ", ".join(f"{v:.4g}" for v in x) for x in (self.alarm_reading, self.alarm_expected)
        )
        told = f"ALARMS: {self.alarms}, the last at step {self.alarm_k}"
        if not self.alarm_expected:
            return f"{told}: too many steps had no digit of the key stream"
        return f"{told}: read ({read}), expected ({expected})"


Status = PlantStatus | ControllerStatus

MANAGEMENT: tuple[type[Message], ...] = (
    PlantHello,
    ControllerHello,
    SendCommand,
    SendReply,
    StopKeys,
    PlantModel,
    PlantStatus,
    ControllerStatus,
)
