"""Ops messages: between controller, plant, dashboard and operator, out of her reach."""

from collections.abc import Iterable
from functools import cache
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from protocol.messages.base import (
    BlockNumber,
    Count,
    Fingerprint,
    Identifier,
    Message,
    SessionId,
    Tag,
)
from protocol.vectors import FiniteVector


class PlantHello(Message):
    """The plant asks ``controller`` to take up ``session``; repeated until it is answered.

    With None it looks for a controller: whoever greets is asked next. All others learn from it that
    the session is not theirs. ``incarnation`` is that of the controller asked last, as it greeted.
    """

    topic: ClassVar[str] = "ops/plant/hello"
    instance: SessionId
    session: SessionId
    controller: SessionId | None = None
    incarnation: Count
    fingerprint: Fingerprint
    transitions: Count
    applied_k: Annotated[int, Field(ge=-1)]


class ControllerHello(Message):
    """The controller's answer to a plant's hello, or (``greeting``) its word after a start.

    A greeting names the session that the controller's journal holds, an answer the one asked for.
    ``incarnation`` counts the processes that had this journal.
    """

    topic: ClassVar[str] = "ops/controller/hello"
    instance: SessionId
    incarnation: Count
    fingerprint: Fingerprint
    verdict: Literal["greeting", "accepted", "unknown-session", "other-model"]
    session: SessionId | None = None
    answers: SessionId | None = None


class _Command(Message):
    """A message that an operator hands over, under an id of his."""

    id: Identifier
    payload: bytes

    model_config = ConfigDict(ser_json_bytes="base64", val_json_bytes="base64")


class SendCommand(_Command):
    """An operator's message for the controller to deliver; the same ``id`` is queued once."""

    topic: ClassVar[str] = "ops/command/send"


class SendReply(Message):
    """The controller's answer to a `SendCommand`."""

    topic: ClassVar[str] = "ops/reply/send"
    id: Identifier
    accepted: bool
    queued: Count
    detail: str = ""


class SealCommand(_Command):
    """An operator's message to be sent sealed; the same ``id`` is taken once."""

    topic: ClassVar[str] = "ops/command/seal"


class SealReply(Message):
    """The controller's answer to a `SealCommand`, each time that it comes."""

    topic: ClassVar[str] = "ops/reply/seal"
    id: Identifier
    accepted: bool
    delivered: bool
    detail: str = ""


class SealedReceipt(Message):
    """The plant's acknowledgement of a `Sealed`, each time that it comes.

    ``refused`` says why it will never open it, and ``key_ids`` are then those of the message.
    """

    topic: ClassVar[str] = "ops/plant/receipt"
    id: Identifier
    key_ids: Annotated[tuple[Identifier, ...], Field(max_length=4096)] = ()
    refused: str = ""


_Use = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9._ -]{1,128}$")]
_Names = Annotated[
    tuple[Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9._/-]{1,64}$")], ...],
    Field(max_length=4096),
]


_What = Literal["keys", "pads", "unused", "made", "marked", "ready", "blocks", "lacked"]


class BlockAnnouncement(Message):
    """An end's word on key blocks once no step is left to carry it: the other end answers it.

    ``waiting`` counts blocks that are whole there and not confirmed.
    """

    topic: ClassVar[str] = "ops/keys/word"
    side: Literal["controller", "plant"]
    session: SessionId
    block: BlockNumber
    tag: Tag
    waiting: Count


class KeyRequest(Message):
    """An end asks the other to mark ``keys``, or ``pads``, that it is about to give, for a use.

    After its start it asks besides which of those that it holds were given before: keys that it
    knows of no use for (``unused``, and ``made`` for those made since), keys that were given there
    (``marked``), pads (``ready``); which blocks it had beyond its newest ``blocks``; which of its
    own are ``lacked`` there. It is said again until it is answered.
    """

    topic: ClassVar[str] = "ops/keys/request"
    side: Literal["controller", "plant"]
    use: _Use
    what: _What
    names: _Names


class KeyAnswer(Message):
    """The answer to a `KeyRequest` of ``side``: names that it must not give; none: all marked."""

    topic: ClassVar[str] = "ops/keys/answer"
    side: Literal["controller", "plant"]
    use: _Use
    what: _What
    refused: _Names


_Rows = Annotated[tuple[FiniteVector, ...], Field(min_length=1)]


def _alike(rows: Iterable[tuple[float, ...]]) -> bool:
    """Whether all have one length."""
    return len({len(row) for row in rows}) <= 1


LATENCY_BOUNDS_S: Final = (
    *(0.0005, 0.001, 0.0015, 0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.01),
    *(0.015, 0.02, 0.03, 0.05, 0.075, 0.1, 0.2, 0.5, 1.0),
)
"""Upper bounds of a status's counts of latencies, seconds."""


class PlantModel(Message):
    """What does not change while a plant's process lives, for the dashboard: said now and then.

    It travels right before a status: the first one, and one in a second or few. ``A``, ``B`` are
    the controller's f_c, {d : H d <= h} is D_c, ``alpha`` that of D_e, which is alpha D_c where
    ``eavesdropper_H`` is empty; ``keys_claim`` says under which claim keys are secret, and is empty
    where none are made.
    """

    topic: ClassVar[str] = "ops/plant/model"
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
"""What a status says on ops and no file keeps: texts, and the last keys and coins."""


class _Status(Message):
    """What an end of the loop knows: published at a bounded rate, the newest wins.

    The ends make theirs by ``model_construct``: a quarter of the time, and tests validate what they
    say.
    """

    seq: Count
    t_ns: Count
    phase: str
    detail: str = ""

    def on_file(self) -> bytes:
        """The status as a file may keep it: no text, and none of the last keys and coins."""
        return self.__pydantic_serializer__.to_json(self, exclude=_withheld(type(self)))


@cache
def _withheld(kind: type[_Status]) -> set[str]:
    return {
        name
        for name in kind.model_fields
        if name in SECRET_FIELDS or name.startswith(SECRET_PREFIXES)
    }


class PlantStatus(_Status):
    """What the plant knows, for the dashboard: published at a bounded rate, the newest wins.

    The ``tail_*`` lists are parallel and hold the last transitions, oldest first: those since the
    last status but one, 8 at least and 64 at most; 64 where a `PlantModel` went before.
    ``tail_role`` is ``message`` where the transition carried a message symbol, else ``test``;
    ``tail_symbol`` is the key symbol of an agreement and -1 where none was agreed, ``tail_coin``
    the candidate b_r that was applied, ``tail_automaton`` the state s of the scheme afterwards.
    ``outside`` counts transitions whose disturbance left D_c and ``unexplained`` those that no
    candidate explains; ``sampled_late_s`` and ``actuated_after_s`` are median, 99th percentile and
    largest of the last steps, empty in lock-step.
    ``keys_made`` counts keys of confirmed blocks in this process's life, ``keys_of_block`` those of
    the last one and ``key_block_steps`` its steps; ``keys_refused`` says why nobody gets them, and
    ``keys_stopped`` why the session's newest block made none: empty again once a later one has made
    some. ``key_blocks_lost`` counts those that made none in this process's life, and
    ``key_blocks_waiting`` those that are whole and that the partner has not confirmed.
    ``key_blocks_begun`` counts all that were begun, in all lives: each may be ``eps_sec`` away
    from perfect keys, whatever became of it. A message on the field bus leaves ``appearances``
    times.
    ``pictured_*`` describe one transition in the plane, as in the paper's Fig. 4;
    ``pictured_inside`` counts the candidates that explain it within D_c. ``message_k`` is
    the step at which ``last_message`` was whole (-1: none yet, or before this process began).
    ``latency_counts`` says how long offers took, from a step's first measurement to its offer: one
    count for each bound of `LATENCY_BOUNDS_S`, not cumulative, and one for all above.
    """

    topic: ClassVar[str] = "ops/plant/status"
    phase: Literal["greeting", "running", "stopped", "refused"]
    session: SessionId
    sessions: Count
    k: Count
    x: FiniteVector
    transitions: Count
    missed: Count
    late: Count
    malformed: Count
    agreements: Count
    symbol_errors: Count
    rate_hz: float
    automaton: Count
    recovered_symbols: Count
    messages: Count
    last_message: str = ""
    message_k: Annotated[int, Field(ge=-1)] = -1
    latency_counts: tuple[Count, ...] = ()
    partial: str = ""
    frame_symbols: Count
    frame_length: Count
    frames_refused: Count
    outside: Count = 0
    unexplained: Count = 0
    sampled_late_s: FiniteVector = ()
    actuated_after_s: FiniteVector = ()
    overruns: Count = 0
    keys_made: Count = 0
    keys_of_block: Count = 0
    key_block_steps: Count = 0
    keys_refused: str = ""
    keys_stopped: str = ""
    key_blocks_lost: Count = 0
    key_blocks_waiting: Count = 0
    key_blocks_begun: Count = 0
    appearances: Count = 1
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

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        n = len(self.x)
        tails = (self.tail_k, self.tail_x, self.tail_role, self.tail_symbol, self.tail_coin)
        states = self.tail_x
        if self.pictured_k >= 0:
            states = (*states, self.pictured_x, self.pictured_x_next)
        if (
            any(len(tail) != len(self.tail_automaton) for tail in tails)
            or any(len(row) != n for row in states)
            or not _alike(self.pictured_candidates)
            or len(self.pictured_gauges) != len(self.pictured_candidates)
            or len(self.latency_counts) not in (0, len(LATENCY_BOUNDS_S) + 1)
        ):
            raise ValueError("expected vectors that fit together")
        return self


class ControllerStatus(_Status):
    """What the controller knows, for the dashboard: published at a bounded rate, the newest wins.

    ``sending`` is the text on its way and ``queue`` counts the messages behind it. When all is
    sent, ``sending`` keeps the last one and ``frame_symbols`` equals ``frame_length``.
    ``unexplained`` counts transitions of this process's life that no candidate explains; the
    fields of keys are those of `PlantStatus`.
    """

    topic: ClassVar[str] = "ops/controller/status"
    phase: Literal["greeting", "running", "outside", "stopped", "refused"]
    session: SessionId | None
    k: Annotated[int, Field(ge=-1)]
    set_index: Annotated[int, Field(ge=-1)]
    transitions: Count
    agreements: Count
    malformed: Count
    automaton: Count
    sending: str = ""
    frame_symbols: Count
    frame_length: Count
    queue: Count
    delivered: Count
    unexplained: Count = 0
    keys_made: Count = 0
    keys_of_block: Count = 0
    key_block_steps: Count = 0
    keys_refused: str = ""
    keys_stopped: str = ""
    key_blocks_lost: Count = 0
    key_blocks_waiting: Count = 0
    appearances: Count = 1


Status = PlantStatus | ControllerStatus

OPS: tuple[type[Message], ...] = (
    PlantHello,
    ControllerHello,
    SendCommand,
    SendReply,
    SealCommand,
    SealReply,
    SealedReceipt,
    BlockAnnouncement,
    KeyRequest,
    KeyAnswer,
    PlantModel,
    PlantStatus,
    ControllerStatus,
)
