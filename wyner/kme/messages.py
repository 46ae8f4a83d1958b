"""The objects of ETSI GS QKD 014 V1.1.1 (2019-02), with the field names of its tables 9 to 14."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

Extension = dict[str, Any]


class Request(BaseModel):
    """What a client sends; fields that the standard does not know are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)


class KeyRequest(Request):
    """Table 11: how many keys, of which size in bits."""

    number: int = 1
    size: int | None = None
    additional_slave_SAE_IDs: tuple[str, ...] = Field(default=(), strict=False)
    extension_mandatory: tuple[Extension, ...] = Field(default=(), strict=False)
    extension_optional: tuple[Extension, ...] = Field(default=(), strict=False)


class KeyId(Request):
    """An entry of table 13."""

    key_ID: Annotated[str, Field(min_length=1, max_length=64)]


class KeyIds(Request):
    """Table 13: the keys that a slave asks for."""

    key_IDs: tuple[KeyId, ...] = Field(min_length=1, strict=False)


class KmeAnswer(BaseModel):
    """What a key management entity sends."""

    model_config = ConfigDict(frozen=True)


class Status(KmeAnswer):
    """Table 10."""

    source_KME_ID: str
    target_KME_ID: str
    master_SAE_ID: str
    slave_SAE_ID: str
    key_size: int
    stored_key_count: int
    max_key_count: int
    max_key_per_request: int
    max_key_size: int
    min_key_size: int
    max_SAE_ID_count: int
    status_extension: Extension


class DeliveredKey(KmeAnswer):
    """An entry of table 12: a UUID and the key in base64."""

    key_ID: str
    key: str


class KeyContainer(KmeAnswer):
    """Table 12. The table prints ``Keys``, every example ``keys``: clients read the latter."""

    keys: tuple[DeliveredKey, ...]
    key_container_extension: Extension


class Error(KmeAnswer):
    """Table 14."""

    message: str
    details: tuple[Extension, ...] = ()
