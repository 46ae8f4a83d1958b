"""Management messages: of controller, plant, dashboard and operator; the tap must not hear them."""

import base64
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, Self

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from protocol.messages.base import (
    Count,
    Fingerprint,
    Identifier,
    Malformed,
    Message,
    Metric,
    Part,
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
"""Upper bounds of the bins of `TimingStatus.latency_counts`, in seconds."""


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


class StepStatus(Part):
    """How far the link is, as an end counts it.

    Attributes
    ----------
    k, x : int, tuple of float
        The step (at the controller the one answered last; -1: none), and the state x(k), n numbers.
    transitions, agreements, symbols : int
        Transitions of the session, key symbols agreed on, and message symbols carried.
    automaton : int
        The scheme's state s.
    unexplained : int
        Transitions since this process began that no candidate explains.
    """

    k: Annotated[
        int, Field(ge=-1), Metric("steps", "the step that the end is at, missed ones counted")
    ]
    x: FiniteVector
    transitions: Count
    agreements: Annotated[
        Count, Metric("agreements", "transitions on which a key symbol was agreed")
    ]
    symbols: Count
    automaton: Count
    unexplained: Count = 0


class PlantStep(StepStatus):
    """What the plant alone knows of its steps.

    Attributes
    ----------
    missed, symbol_errors, outside : int
        Steps without an offer in time; key symbols agreed on that are not the coin; transitions
        whose disturbance left D_c.
    """

    missed: Annotated[Count, Metric("missed_steps", "steps without an offer in time")]
    symbol_errors: Annotated[
        Count, Metric("symbol_errors", "agreements on a symbol that was not applied")
    ]
    outside: Count = 0


class FrameStatus(Part):
    """The frame under way: its symbols so far, and in all.

    When all is sent the controller shows the last one, whose symbols are then all there.
    """

    symbols: Count
    length: Count


class IncomingFrame(FrameStatus):
    """The plant's frames: whole messages, the step of the last one (-1: none by this process),
    and frames that failed their check."""

    messages: Annotated[Count, Metric("messages_recovered", "whole messages that the plant has")]
    message_k: Annotated[int, Field(ge=-1)] = -1
    refused: Annotated[Count, Metric("frames_refused", "frames that failed their check")]


class OutgoingFrame(FrameStatus):
    """The controller's: messages of which every symbol was counted, and those that wait behind
    the one on its way."""

    delivered: Annotated[
        Count, Metric("messages_delivered", "messages of which every symbol was counted")
    ]
    queue: Count


class KeyStatus(Part):
    """What an end has of distilled keys.

    Attributes
    ----------
    made, lost : int
        Keys of confirmed blocks, and blocks that made none, since this process began.
    begun : int
        Blocks begun by all incarnations. Each adds ``eps_sec`` to the distance from perfect keys,
        whatever became of it.
    of_block, block_steps : int
        Keys and steps of the last confirmed block.
    refused : str
        Why no key is made any more; empty while some are.
    stopped : str
        Why the session's newest block made no key; empty once a later one has made some.
    digits_left : int
        Digits of the key stream that this end holds.
    appearances : int
        How often a message leaves this end on the field bus.
    """

    made: Annotated[
        Count, Metric("keys_made", "keys of confirmed blocks since this process began")
    ] = 0
    lost: Annotated[Count, Metric("keys_blocks_lost", "key blocks that made no key since then")] = 0
    begun: Count = 0
    of_block: Count = 0
    block_steps: Count = 0
    refused: str = ""
    stopped: Annotated[
        str, Metric("keys_stopped", "whether the newest block made no key", "gauge")
    ] = ""
    digits_left: Annotated[
        Count, Metric("keys_digits_left", "unused digits of the key stream", "gauge")
    ] = 0
    appearances: Count = 1


class TimingStatus(Part):
    """How punctual the plant is.

    Attributes
    ----------
    late : int
        Offers that came after their step.
    rate_hz : float
        Transitions a second, over the last few seconds.
    latency_counts : tuple of int
        Offers by the seconds from a step's first measurement to its offer: a bin for each bound of
        `LATENCY_BOUNDS_S`, not cumulative, and one above them.
    sampled_late_s, actuated_after_s : tuple of float
        Median, 99th percentile and largest of the last steps, in seconds; empty in lock-step.
    overruns : int
        Ticks that went by unnoticed.
    """

    late: Annotated[Count, Metric("late_offers", "offers that came after their step")]
    rate_hz: float
    latency_counts: Annotated[
        tuple[Count, ...],
        Field(min_length=len(LATENCY_BOUNDS_S) + 1, max_length=len(LATENCY_BOUNDS_S) + 1),
        Metric(
            "offer_latency_seconds",
            "from a step's first measurement to its offer",
            "histogram",
            LATENCY_BOUNDS_S,
        ),
    ]
    sampled_late_s: FiniteVector = ()
    actuated_after_s: FiniteVector = ()
    overruns: Count = 0


class AlarmStatus(Part):
    """The controller's watch over the plant.

    Attributes
    ----------
    watched, unwatched : int
        Transitions since this process began that were tested against the one candidate that a digit
        of the key stream chose; and, where the coin is keyed, those that could not be.
    count, k : int
        Alarms since this process began, and the step of the last one (-1: none).
    reading, expected, gauge : tuple of float, tuple of float, float
        What was read after that step, what was expected, and how far apart they are, in D_c.
        Nothing is expected where too many steps had no digit of the key stream.
    """

    watched: Annotated[
        Count, Metric("watched_steps", "transitions tested by a key's candidate")
    ] = 0
    unwatched: Annotated[
        Count, Metric("unwatched_steps", "transitions that no key watched, of a keyed coin")
    ] = 0
    count: Annotated[Count, Metric("alarms", "transitions whose test failed and made an alarm")] = 0
    k: Annotated[int, Field(ge=-1)] = -1
    reading: FiniteVector = ()
    expected: FiniteVector = ()
    gauge: float = 0.0

    def sentence(self) -> str:
        """The alarms and the last one, in words; empty where there is none."""
        if not self.count:
            return ""
        told = f"ALARMS: {self.count}, the last at step {self.k}"
        if not self.expected:
            return f"{told}: too many steps had no digit of the key stream"
        read, expected = (", ".join(f"{v:.4g}" for v in x) for x in (self.reading, self.expected))
        return f"{told}: read ({read}), expected ({expected})"


class PicturedStep(Part):
    """One transition, to be drawn as in the paper's Fig. 4.

    Attributes
    ----------
    k, gauges, symbol : int, tuple of float, int
        Its step, the gauge of each candidate, and the key symbol agreed on (-1: none).
    inside : int
        Candidates that explain it within D_c.
    """

    k: Count
    gauges: FiniteVector
    symbol: Annotated[int, Field(ge=-1)]
    inside: Count


class TailStep(NamedTuple):
    """A transition that the plant has counted.

    Parameters
    ----------
    k, x : int, tuple of float
    role : {"test", "message"}
        Whether it carried a message symbol.
    symbol : int
        The key symbol agreed on; -1: none.
    coin : int
        The applied candidate b_r.
    true_x_next : tuple of float
        Of an attacked plant: the true state after it.
    """

    k: int
    x: FiniteVector
    role: Literal["test", "message"]
    symbol: int
    coin: int
    true_x_next: FiniteVector = ()


class EndSecrets(Part):
    """What travels on the management bus only, in no file: the message under way."""

    message: str = ""


class PlantSecrets(EndSecrets):
    """The plant's: texts, the last keys and coins.

    Attributes
    ----------
    last_message : str
        The last whole message.
    pictured : PicturedStep or None
    tail : tuple of TailStep
        The last transitions, oldest first: those since the last status but one, 8 to 64; 64 after a
        `PlantModel`.
    """

    last_message: str = ""
    pictured: PicturedStep | None = None
    tail: tuple[TailStep, ...] = ()


class Status(Message):
    """What one end of the loop knows. It is published at a bounded rate; the newest wins.

    The ends build theirs by ``model_construct``, which takes a quarter of the time of validation;
    tests validate what they publish.

    Attributes
    ----------
    seq, t_ns : int
        Number of the status, and when it was made, in nanoseconds.
    phase, detail : str
        What the end is doing, and why it does no more.
    malformed : int
        Messages that could not be read.
    """

    seq: Count
    t_ns: Count
    phase: str
    detail: str = ""
    malformed: Malformed
    session: SessionId | None
    step: StepStatus
    frame: FrameStatus
    keys: KeyStatus = KeyStatus()
    secrets: EndSecrets = EndSecrets()

    def on_file(self) -> bytes:
        """The status as a file may keep it, without the secrets."""
        return self.__pydantic_serializer__.to_json(self, exclude={"secrets"})


class PlantStatus(Status):
    """What the plant knows, for the dashboard.

    Attributes
    ----------
    sessions : int
        Sessions begun, this one included.
    attack : str
        What attacks the plant. It says so to whoever watches; no end acts on it.
    """

    topic: ClassVar[str] = "management/plant/status"
    phase: Literal["greeting", "running", "stopped", "refused"]
    session: SessionId
    sessions: Count
    step: PlantStep
    frame: IncomingFrame
    timing: TimingStatus
    attack: str = ""
    secrets: PlantSecrets = PlantSecrets()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        n = len(self.step.x)
        for row in self.secrets.tail:
            if len(row.x) != n or len(row.true_x_next) not in (0, n):
                raise ValueError(f"expected states of {n} numbers")
        return self


class ControllerStatus(Status):
    """What the controller knows, for the dashboard.

    Attributes
    ----------
    set_index : int
        i(k), the smallest i with x(k) in T_i; -1: in none.
    """

    topic: ClassVar[str] = "management/controller/status"
    phase: Literal["greeting", "running", "outside", "alarmed", "stopped", "refused"]
    set_index: Annotated[int, Field(ge=-1)]
    frame: OutgoingFrame
    alarms: AlarmStatus = AlarmStatus()


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
