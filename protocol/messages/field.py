"""Field messages, read by everyone: no key, no plaintext, no state, and one form in all states."""

from typing import Annotated, ClassVar

from pydantic import ConfigDict, Field, StringConstraints

from protocol.messages.base import (
    BlockNumber,
    Copy,
    Count,
    Identifier,
    Message,
    Nonce,
    SessionId,
    Tag,
)
from protocol.vectors import FiniteVector


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

    ``predictions`` are the predictions f_c(x, u_i) where f_c is not linear, else none. ``heard`` is
    the copy of that measurement which came first; the other fields of keys are those of
    `Measurement`.
    """

    topic: ClassVar[str] = "offer"
    session: SessionId
    k: Count
    candidates: tuple[FiniteVector, ...]
    cipher: Count
    predictions: tuple[FiniteVector, ...] = ()
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


FieldMessage = Measurement | Offer | Sealed
FIELD: tuple[type[FieldMessage], ...] = (Measurement, Offer, Sealed)
