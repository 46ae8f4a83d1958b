"""The wire: flat schemas, nothing secret on the field bus, malformed refused."""

import json
from typing import Any

import pytest
from pydantic import ValidationError

from protocol.messages import (
    ADVERSARY,
    FIELD,
    MANAGEMENT,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantModel,
    PlantStatus,
    SendReply,
)
from protocol.topics import BASE, check_loop, key_of
from runtime.chance import fresh_nonce
from tests.support.rehearsal import Rehearsal

ALL = (*FIELD, *MANAGEMENT, *ADVERSARY)
SESSION = "0123456789abcdef"

MEASUREMENT: dict[str, Any] = {
    "session": SESSION,
    "k": 7,
    "x": [0.1, -2.5e-17],
    "applied_k": 6,
    "x_after": [0.1, -2.5e-17],
}
OF_KEYS = ("copy_number", "nonce", "block", "tag")
OFFER: dict[str, Any] = {
    "session": SESSION,
    "k": 7,
    "candidates": [[0.30000000000000004], [-5.9]],
    "cipher": 1,
}


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
def test_schemas_are_strict_and_those_of_the_field_are_flat(kind: type[Message]) -> None:
    if kind in FIELD:
        assert "$ref" not in json.dumps(kind.model_json_schema())
    assert kind.model_config["extra"] == "forbid"
    assert kind.model_config["frozen"]


def test_every_message_has_a_key_of_its_own() -> None:
    keys = {key_of(kind, "loop") for kind in ALL}
    assert len(keys) == len(ALL)
    assert all(key.startswith(f"{BASE}/v2/loop/") for key in keys)
    field = {key_of(kind, "loop") for kind in FIELD}
    assert not any(key.startswith(f"{BASE}/v2/loop/management/") for key in field)


@pytest.mark.parametrize("loop", ["", "a/b", "*", "**", "@a", "a b", "-a", "x" * 65, "ä"])
def test_a_loop_id_is_one_plain_chunk(loop: str) -> None:
    with pytest.raises(ValueError, match="expected 1 to 64"):
        check_loop(loop)


def test_the_field_bus_has_these_messages_with_these_fields_only() -> None:
    """A key, a plaintext or a state would need a field: adding one must not go unnoticed."""
    assert {kind.__name__: set(kind.model_fields) for kind in FIELD} == {
        "Measurement": {
            *("v", "session", "k", "x", "applied_k", "x_after", "applied_copy", "keyed"),
            *OF_KEYS,
        },
        "Offer": {
            *("v", "session", "k", "candidates", "cipher", "predictions", "heard"),
            *("stream_block", "stream_at"),
            *OF_KEYS,
        },
    }


def test_the_fields_of_keys_have_one_form() -> None:
    nonce = fresh_nonce()
    lengths = {
        len(Offer(**OFFER, copy_number=copy, nonce=fresh_nonce(), tag=tag * 32).wire())
        for copy in (0, 1)
        for tag in "0f"
    }
    assert len(lengths) == 1
    for wrong in (nonce[:-1], nonce[:-1] + "A", nonce + "=", "*" + nonce[1:], "="):
        with pytest.raises(ValidationError, match="nonce"):
            Measurement(**MEASUREMENT, nonce=wrong)
    for name, value in (("copy_number", 2), ("block", -2), ("tag", "0" * 31), ("tag", "G" * 32)):
        with pytest.raises(ValidationError, match=name):
            Offer(**OFFER, **{name: value})


def test_an_offer_is_as_long_whatever_the_cipher_symbol() -> None:
    lengths = {len(Offer(**{**OFFER, "cipher": c}).model_dump_json()) for c in (0, 1)}
    assert len(lengths) == 1


@pytest.mark.parametrize(("kind", "data"), [(Measurement, MEASUREMENT), (Offer, OFFER)])
def test_field_messages_come_back_to_the_last_bit(
    kind: type[Message], data: dict[str, Any]
) -> None:
    message = kind(**data)
    again = kind.model_validate_json(message.model_dump_json())
    assert again == message
    assert again.model_dump_json() == message.model_dump_json()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("v", 1),
        ("v", 0),
        ("session", "0123"),
        ("session", SESSION.upper()),
        ("session", SESSION + "\n"),
        ("k", -1),
        ("k", 1.5),
        ("k", None),
        ("x", ["NaN", 0.0]),
        ("x", "0.1"),
        ("applied_k", -2),
    ],
)
def test_a_wrong_field_is_refused(field: str, value: object) -> None:
    with pytest.raises(ValidationError):
        Measurement.model_validate_json(json.dumps({**MEASUREMENT, field: value}))


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_none_are_refused(number: str) -> None:
    text = json.dumps(OFFER).replace("-5.9", number)
    assert number in text
    with pytest.raises(ValidationError):
        Offer.model_validate_json(text)


@pytest.mark.parametrize("extra", ["key", "symbol", "s", "message", "plaintext"])
def test_unknown_fields_are_refused(extra: str) -> None:
    for kind, data in ((Measurement, MEASUREMENT), (Offer, OFFER)):
        with pytest.raises(ValidationError, match="Extra inputs"):
            kind.model_validate_json(json.dumps({**data, extra: 0}))


@pytest.mark.parametrize(
    "payload", [b"", b"{}", b"[]", b"null", b"\xff\xfe", b'{"v":1', b"0" * 10**5]
)
def test_a_malformed_message_is_refused(payload: bytes) -> None:
    for kind in ALL:
        with pytest.raises(ValidationError):
            kind.model_validate_json(payload)


def test_a_file_of_a_status_holds_no_text_key_or_coin() -> None:
    batch = list(Rehearsal().arrivals(1200))[-1]
    for kind in (PlantStatus, ControllerStatus):
        status = next(a.message for a in batch if isinstance(a.message, kind))
        kept = json.loads(status.on_file())
        assert kept.keys() == set(kind.model_fields) - {"secrets"}
        told = status.model_dump(mode="json")
        assert kept == {name: told[name] for name in kept}
        assert kind.model_validate_json(status.on_file()).step == status.step
        secret = [status.secrets.message]
        if isinstance(status, PlantStatus):
            secret.append(status.secrets.last_message)
        assert not any(text.encode() in status.on_file() for text in secret if text)


@pytest.mark.parametrize(
    "changes",
    [
        {"A": ((1.0,),)},
        {"B": ()},
        {"B": ((1.0,), (1.0, 2.0))},
        {"defender_h": (1.0,)},
        {"defender_H": (), "defender_h": ()},
        {"defender_H": ((1.0,),), "defender_h": (1.0,)},
    ],
)
def test_a_model_that_does_not_fit_together_is_refused(changes: dict[str, Any]) -> None:
    model = next(Rehearsal().arrivals(10))[0].message
    assert isinstance(model, PlantModel)
    assert PlantModel.model_validate(model.model_dump()) == model
    with pytest.raises(ValidationError):
        PlantModel.model_validate({**model.model_dump(), **changes})


@pytest.mark.parametrize("identifier", ["", "a b", "x" * 65, "ü", "a/b"])
def test_an_identifier_is_short_and_plain(identifier: str) -> None:
    with pytest.raises(ValidationError):
        SendReply(id=identifier, accepted=True, queued=0)
