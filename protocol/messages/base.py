"""What all messages share: the version of the wire, the types of their fields, their form."""

from typing import Annotated, ClassVar, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from protocol.secret.nonces import NONCE_FORM

SCHEMA: Final = 3
"""Version of the wire format; a message of another version is malformed."""

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
    v: Literal[3] = SCHEMA

    def wire(self) -> bytes:
        """The message as it travels: JSON in UTF-8."""
        # what model_dump_json does, without turning bytes into text and back
        return self.__pydantic_serializer__.to_json(self)
