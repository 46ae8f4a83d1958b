"""The messages on the wire: flat, frozen, versioned, and nothing secret on the field bus.

Three buses, three families. *Field* messages (`Measurement`, `Offer`) are read by the tap; they
hold no key, no plaintext, no automaton state, and look the same in both automaton states. *Ops*
messages pass between controller, plant, dashboard and operator. *Intel* messages carry the tap's
guesses.
Models are flat (no nested model), so that a recorder's schema of each needs no reference.
"""

from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from protocol.secret.nonces import NONCE_FORM
from protocol.vectors import FiniteVector

SCHEMA: Final = 2
"""Version of the wire format; a message of another version is garbage."""

SessionId = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
Fingerprint = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Identifier = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
LARGEST_COUNT: Final = 2**63 - 1
Count = Annotated[int, Field(ge=0, le=LARGEST_COUNT)]
Copy = Literal[0, 1]
Nonce = Annotated[str, StringConstraints(pattern=NONCE_FORM)]
BlockNumber = Annotated[int, Field(ge=-1)]
Tag = Annotated[str, StringConstraints(pattern=r"^([0-9a-f]{32})?$")]


class Message(BaseModel):
    """What all messages share: they cannot change, and unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    topic: ClassVar[str]
    v: Literal[2] = SCHEMA

    def wire(self) -> bytes:
        """The message as it travels: JSON in UTF-8."""
        # what model_dump_json does, without turning bytes into text and back
        return self.__pydantic_serializer__.to_json(self)


# --- field: read by everyone ---------------------------------------------------------------------


class Measurement(Message):
    """Plant to controller: x(k), and the last applied offer with the state right after it.

    ``applied_k`` is -1 (and ``x_after`` empty) until an offer has been applied in this session.
    ``copy_number`` is 0 for the first copy of Measurement(k), whose ``nonce`` may count, and 1 for
    all others, whose nonce is a dummy; ``applied_copy`` is the copy of the offer that was applied.
    ``block`` is the last key block that the plant has stored, ``tag`` its tag. Where the scenario
    makes no keys these five are 0, empty, 0, -1 and empty always.
    """

    topic: ClassVar[str] = "measurement"
    session: SessionId
    k: Count
    x: FiniteVector
    applied_k: Annotated[int, Field(ge=-1)]
    x_after: FiniteVector
    copy_number: Copy = 0
    nonce: Nonce = ""
    applied_copy: Copy = 0
    block: BlockNumber = -1
    tag: Tag = ""


class Offer(Message):
    """Controller to plant, in answer to Measurement(k): M candidate inputs and a cipher symbol.

    ``centres`` are the predictions f_c(x, u_i) where f_c is not linear, else none. ``heard`` is the
    copy of that measurement which came first; the other fields of keys are those
    of `Measurement`.
    """

    topic: ClassVar[str] = "offer"
    session: SessionId
    k: Count
    candidates: tuple[FiniteVector, ...]
    cipher: Count
    centres: tuple[FiniteVector, ...] = ()
    copy_number: Copy = 0
    nonce: Nonce = ""
    heard: Copy = 0
    block: BlockNumber = -1
    tag: Tag = ""


class Sealed(Message):
    """Controller to plant: a message under a one-time pad, with its one-time tag.

    It is sent at the operator's wish and beside the loop, so it tells nothing of the scheme. Its
    keys are named by their ids and used for nothing else, before or after.
    """

    topic: ClassVar[str] = "sealed"
    id: Identifier
    key_ids: Annotated[tuple[Identifier, ...], Field(min_length=1, max_length=4096)]
    cipher: bytes
    tag: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{32}$")]

    model_config = ConfigDict(ser_json_bytes="base64", val_json_bytes="base64")


# --- ops: controller, plant, dashboard, operator -------------------------------------------------


class PlantHello(Message):
    """The plant asks ``controller`` to take up ``session``; repeated until it is answered.

    With None it looks for a controller: whoever greets is asked next. All others learn from it that
    the session is not theirs. ``life`` is that of the controller asked last, as it greeted.
    """

    topic: ClassVar[str] = "ops/plant/hello"
    instance: SessionId
    session: SessionId
    controller: SessionId | None = None
    life: Count
    fingerprint: Fingerprint
    transitions: Count
    applied_k: Annotated[int, Field(ge=-1)]


class ControllerHello(Message):
    """The controller's answer to a plant's hello, or (``greeting``) its word after a start.

    A greeting names the session that the controller's journal holds, an answer the one asked for.
    ``life`` counts the processes that had this journal.
    """

    topic: ClassVar[str] = "ops/controller/hello"
    instance: SessionId
    life: Count
    fingerprint: Fingerprint
    verdict: Literal["greeting", "accepted", "unknown-session", "other-model"]
    session: SessionId | None = None
    answers: SessionId | None = None


class SendCommand(Message):
    """An operator's message for the controller to deliver; the same ``id`` is queued once."""

    topic: ClassVar[str] = "ops/command/send"
    id: Identifier
    payload: bytes

    model_config = ConfigDict(ser_json_bytes="base64", val_json_bytes="base64")


class SendReply(Message):
    """The controller's answer to a `SendCommand`."""

    topic: ClassVar[str] = "ops/reply/send"
    id: Identifier
    accepted: bool
    queued: Count
    detail: str = ""


LATENCY_BOUNDS_S: Final = (
    *(0.0005, 0.001, 0.0015, 0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.01),
    *(0.015, 0.02, 0.03, 0.05, 0.075, 0.1, 0.2, 0.5, 1.0),
)
"""Upper bounds of a status's counts of latencies, seconds."""


class SealCommand(Message):
    """An operator's message to be sent sealed; the same ``id`` is taken once."""

    topic: ClassVar[str] = "ops/command/seal"
    id: Identifier
    payload: bytes

    model_config = ConfigDict(ser_json_bytes="base64", val_json_bytes="base64")


class SealReply(Message):
    """The controller's answer to a `SealCommand`, each time that it comes."""

    topic: ClassVar[str] = "ops/reply/seal"
    id: Identifier
    accepted: bool
    delivered: bool
    detail: str = ""


class SealedReceipt(Message):
    """The plant's acknowledgement of a `Sealed`, each time that it comes."""

    topic: ClassVar[str] = "ops/plant/receipt"
    id: Identifier


class PlantStatus(Message):
    """What the plant knows, for the dashboard: published at a bounded rate, the newest wins.

    The ``tail_*`` lists are parallel and hold the last transitions, oldest first; ``tail_role`` is
    ``message`` where the transition carried a message symbol, else ``test``; ``tail_symbol`` is the
    key symbol of an agreement and -1 where none was agreed, ``tail_coin`` the candidate b_r that
    was applied, ``tail_automaton`` the state s of the scheme afterwards.
    ``outside`` counts transitions whose disturbance left D_c and ``unexplained`` those that no
    candidate explains; ``sampled_late_s`` and ``actuated_after_s`` are median, 99th percentile and
    largest of the last steps, empty in lock-step.
    ``keys_made`` counts keys of confirmed blocks in this process's life, ``keys_of_block`` those of
    the last one and ``key_block_steps`` its steps; ``keys_claim`` says under which claim they are
    secret, ``keys_refused`` why nobody gets them. Both are empty where no keys are made.
    ``keys_stopped`` says why the last block made none.
    ``pictured_*`` describe one transition in the plane, as in the paper's Fig. 4;
    ``pictured_inside`` counts the candidates that explain it within D_c. ``message_k`` is
    the step at which ``last_message`` was whole (-1: none yet, or before this process began).
    ``latency_counts`` says how long offers took, from a step's first measurement to its offer: one
    count for each bound of `LATENCY_BOUNDS_S`, not cumulative, and one for all above.
    """

    topic: ClassVar[str] = "ops/plant/status"
    seq: Count
    t_ns: Count
    phase: Literal["greeting", "running", "stopped", "refused"]
    detail: str = ""
    scenario: str
    law: str
    pace: str
    seeded: bool
    period_s: float
    alpha: float
    defender_H: tuple[FiniteVector, ...]
    defender_h: FiniteVector
    A: tuple[FiniteVector, ...]
    B: tuple[FiniteVector, ...]
    session: SessionId
    sessions: Count
    k: Count
    x: FiniteVector
    transitions: Count
    missed: Count
    late: Count
    garbage: Count
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
    keys_claim: str = ""
    keys_refused: str = ""
    keys_stopped: str = ""
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
        n, m = len(self.x), len(self.B[0]) if self.B else 0
        tails = (self.tail_k, self.tail_x, self.tail_role, self.tail_symbol, self.tail_coin)
        states = (*self.A, *self.defender_H, *self.tail_x)
        inputs = (*self.B, *self.pictured_candidates)
        if self.pictured_k >= 0:
            states = (*states, self.pictured_x, self.pictured_x_next)
        if (
            any(len(tail) != len(self.tail_automaton) for tail in tails)
            or any(len(row) != n for row in states)
            or any(len(row) != m for row in inputs)
            or {len(self.A), len(self.B)} - {0, n}
            or len(self.defender_h) != len(self.defender_H)
            or len(self.pictured_gauges) != len(self.pictured_candidates)
            or len(self.latency_counts) not in (0, len(LATENCY_BOUNDS_S) + 1)
        ):
            raise ValueError("expected vectors that fit together")
        return self


class ControllerStatus(Message):
    """What the controller knows, for the dashboard: published at a bounded rate, the newest wins.

    ``sending`` is the text on its way and ``queue`` counts the messages behind it. When all is
    sent, ``sending`` keeps the last one and ``frame_symbols`` equals ``frame_length``.
    ``unexplained`` counts transitions of this process's life that no candidate explains; the
    fields of keys are those of `PlantStatus`.
    """

    topic: ClassVar[str] = "ops/controller/status"
    seq: Count
    t_ns: Count
    phase: Literal["greeting", "running", "outside", "stopped", "refused"]
    detail: str = ""
    scenario: str
    seeded: bool
    session: SessionId | None
    k: Annotated[int, Field(ge=-1)]
    set_index: Annotated[int, Field(ge=-1)]
    horizon: Count
    transitions: Count
    agreements: Count
    garbage: Count
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
    keys_claim: str = ""
    keys_refused: str = ""
    keys_stopped: str = ""


SECRET_FIELDS: Final = frozenset({"last_message", "partial", "sending"})
SECRET_PREFIXES: Final = ("tail_", "pictured_")
"""What a status says on ops and no file keeps: texts, and the last keys and coins."""


def without_secrets(status: dict[str, Any]) -> dict[str, Any]:
    """A status as a file may keep it."""
    return {
        name: value
        for name, value in status.items()
        if name not in SECRET_FIELDS and not name.startswith(SECRET_PREFIXES)
    }


# --- intel: the tap and whoever watches it -------------------------------------------------------


class TapStatus(Message):
    """One eavesdropper's view of the link, published by the tap at a bounded rate.

    The ``tail_*`` lists are parallel, oldest first: the transition's step k, the likeliest symbol,
    its probability, and the probability that a key was agreed there. ``message`` is the best
    message so far (text, unprintable bytes shown as ``·``), ``confidence`` how sure she is of it.
    ``candidates_left`` counts the messages still possible to her (0: not counted by this kind).
    ``A``, ``B`` are the model she has learned or was given; ``solved_k`` is the step at which she
    first was sure of a whole message (-1: not yet).
    Of one who attacks keys: ``key_blocks`` made keys, ``key_bits_held`` is what she can compute of
    their rows (-1: this one does not try). Of ``copies`` 0 she missed ``copies_missed``, at most a
    share ``missed_at_most``; that may refute the claim. Of sealed texts heard lately she knows
    ``sealed_bits_known``; ``sealed_text`` is the last one, with · for what she does not.
    """

    topic: ClassVar[str] = "intel/tap/status"
    seq: Count
    t_ns: Count
    name: str
    steps: Count
    lost: Count
    mirrored: Count
    capture_bytes: Count
    dropped: Count
    behind: Count
    garbage: Count
    message: str
    confidence: float
    candidates_left: Count
    solved_k: Annotated[int, Field(ge=-1)]
    A: tuple[FiniteVector, ...] = ()
    B: tuple[FiniteVector, ...] = ()
    key_blocks: Count = 0
    key_bits_held: Annotated[int, Field(ge=-1)] = -1
    copies: Count = 0
    copies_missed: Count = 0
    missed_at_most: float = 1.0
    claim_refuted: bool = False
    misses_in_bursts: bool = False
    sealed_bits: Count = 0
    sealed_bits_known: Count = 0
    sealed_text: str = ""
    tail_k: tuple[int, ...] = ()
    tail_symbol: tuple[int, ...] = ()
    tail_probability: FiniteVector = ()
    tail_agreed: FiniteVector = ()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        tails = (self.tail_k, self.tail_symbol, self.tail_probability)
        if any(len(tail) != len(self.tail_agreed) for tail in tails):
            raise ValueError("expected tails of one length")
        return self


FieldMessage = Measurement | Offer | Sealed
FIELD: tuple[type[FieldMessage], ...] = (Measurement, Offer, Sealed)
OPS: tuple[type[Message], ...] = (
    PlantHello,
    ControllerHello,
    SendCommand,
    SendReply,
    SealCommand,
    SealReply,
    SealedReceipt,
    PlantStatus,
    ControllerStatus,
)
INTEL: tuple[type[Message], ...] = (TapStatus,)
