"""What all messages share: the wire's version, the types of fields, the encoding."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from protocol.secret.nonces import NONCE_FORM

SCHEMA: Final = 4
"""Version of the wire format; a message of another version is malformed."""

SessionId = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
Fingerprint = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Identifier = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
LARGEST_COUNT: Final = 2**63 - 1
"""Largest value of a count: it fits a signed integer of 64 bits."""

Count = Annotated[int, Field(ge=0, le=LARGEST_COUNT)]
Copy = Literal[0, 1]
Nonce = Annotated[str, StringConstraints(pattern=NONCE_FORM)]
BlockNumber = Annotated[int, Field(ge=-1)]
Tag = Annotated[str, StringConstraints(pattern=r"^([0-9a-f]{32})?$")]


@dataclass(frozen=True, slots=True)
class Metric:
    """Of a field of a status that Prometheus is told.

    A ``gauge`` is what is so now; a ``histogram`` is a tuple of counts, and ``bounds`` are the
    upper ends of its bins but the last.
    """

    name: str
    help: str
    kind: Literal["counter", "gauge", "histogram"] = "counter"
    bounds: tuple[float, ...] = ()


Malformed = Annotated[Count, Metric("malformed", "messages that were no messages")]


class Part(BaseModel):
    """Base of messages and of their parts. An instance is frozen; unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Message(Part):
    """Base of what travels as a whole."""

    topic: ClassVar[str]
    v: Literal[4] = SCHEMA

    @classmethod
    def from_wire(cls, payload: bytes) -> Self:
        """The message that ``payload`` is.

        Raises
        ------
        pydantic.ValidationError
            When it is none.
        """
        return cls.model_validate_json(payload)

    def wire(self) -> bytes:
        """The message as it travels: JSON in UTF-8."""
        # model_dump_json without its detour from bytes to text and back
        return self.__pydantic_serializer__.to_json(self)
