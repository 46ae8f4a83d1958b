"""Field messages, which everyone reads: no key, plaintext or state, and one form in all states."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field

from protocol.messages.base import (
    BlockNumber,
    Copy,
    Count,
    Message,
    Nonce,
    SessionId,
    Tag,
)
from protocol.secret.stream import NOWHERE, Position
from protocol.vectors import FiniteVector


class StepMessage(Message):
    """A message of a step: fields that its scenario has no use for are None, and stay away.

    It goes to the journal and to the bus, and is turned into bytes once. One that was heard keeps
    the bytes that came.
    """

    @classmethod
    def from_wire(cls, payload: bytes) -> Self:
        """The message that ``payload`` is, which it keeps."""
        message: Self = cls.__pydantic_validator__.validate_json(payload)
        message.__dict__["_bytes"] = payload
        return message

    def wire(self) -> bytes:
        """The message as it travels: JSON in UTF-8."""
        made: bytes | None = self.__dict__.get("_bytes")
        if made is None:
            made = self.__pydantic_serializer__.to_json(self, exclude_none=True)
            self.__dict__["_bytes"] = made
        return made

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with other values; it has bytes of its own."""
        copy = super().model_copy(update=update, deep=deep)
        for made in ("_bytes", "_position"):
            copy.__dict__.pop(made, None)
        return copy


class Measurement(StepMessage):
    """Plant to controller: x(k), and the last applied offer with the state right after it.

    The five fields from ``copy_number`` on serve keys. In a scenario that makes none they keep
    their defaults.

    Attributes
    ----------
    session : str
        The session's random id, 16 hexadecimal digits.
    k : int
        The step.
    x : tuple of float
        x(k), the state at the start of the step, n numbers.
    applied_k : int
        Step of the last applied offer of this session; -1 before the first.
    x_after : tuple of float
        The state right after that offer's input, n numbers; empty before the first.
    copy_number : {0, 1}
        0: the first copy of Measurement(k), whose nonce may count. 1: any other copy.
    nonce : str
        256 random bits in base64. That of a copy 1 is a dummy and counts for nothing.
    applied_copy : {0, 1}
        Which copy of the offer was applied.
    block : int
        The last key block that the plant has announced; -1 before the first.
    tag : str
        That block's tag, 32 hexadecimal digits.
    keyed : bool, optional
        Whether the digits that the offer names served: they chose the candidate, or were the pad of
        its cipher symbol. Only where the scenario uses the key stream.
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
    keyed: bool | None = None


class Offer(StepMessage):
    """Controller to plant, in answer to Measurement(k): M candidate inputs and a cipher symbol.

    Fields that are not listed are those of `Measurement`.

    Attributes
    ----------
    candidates : tuple of tuple of float
        The M inputs u_i, m numbers each; the plant applies one of them.
    cipher : int
        The cipher symbol, 0 to M - 1.
    predictions : tuple of tuple of float
        f_c(x, u_i), n numbers each, where f_c is not linear; else empty.
    heard : {0, 1}
        Which copy of the measurement the controller received first.
    stream_block, stream_at : int, optional
        Position of the offer's digits in the key stream: the block, and the number of the first
        digit within it; -1 and 0 where it has none. Only where the scenario uses the key stream.
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
    stream_block: BlockNumber | None = None
    stream_at: Count | None = None

    @property
    def position(self) -> Position:
        """Where in the key stream its digits begin; :data:`NOWHERE` where it has none."""
        made: Position | None = self.__dict__.get("_position")
        if made is None:  # a step asks for it six times
            block, at = self.stream_block, self.stream_at
            made = NOWHERE if block is None or at is None or block < 0 else Position(block, at)
            self.__dict__["_position"] = made
        return made


FieldMessage = Measurement | Offer
FIELD: tuple[type[FieldMessage], ...] = (Measurement, Offer)
