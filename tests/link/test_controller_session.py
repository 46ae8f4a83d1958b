"""The controller's table of a session is whole, and a hello's name follows from the record."""

from typing import Any

import pytest

from protocol.link.controller_session import (
    event_of,
)
from protocol.messages import Offer, PlantHello
from tests.support.records import changed, controller_record

S, T, NEW = "1" * 16, "2" * 16, "9" * 16
A, B, P, Q = (letter * 16 for letter in "abcd")
OURS, OTHER = "e" * 64, "f" * 64
OFFER = Offer(session=S, k=7, candidates=((0.0,), (1.0,)), cipher=0)
HELLO = PlantHello(
    instance=P,
    session=S,
    controller=A,
    incarnation=2,
    fingerprint=OURS,
    transitions=0,
    applied_k=5,
)
RECORD = controller_record(session=S, ended=(T,), applied_k=5, offer=OFFER, incarnation=2)


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, "asked, session fits"),
        ({"applied_k": 7}, "asked, session fits"),
        ({"applied_k": 6}, "asked, session does not fit"),
        ({"applied_k": 8}, "asked, session does not fit"),
        ({"applied_k": 4}, "overtaken"),
        ({"applied_k": 4, "instance": Q}, "asked, session does not fit"),
        ({"applied_k": 4, "controller": B}, "overtaken"),
        ({"session": NEW}, "asked, new session"),
        ({"session": NEW, "transitions": 1}, "asked, session unknown"),
        ({"session": T}, "asked, session unknown"),
        ({"controller": None}, "to anyone"),
        ({"controller": None, "incarnation": 3}, "to anyone, of a later incarnation"),
        ({"controller": None, "incarnation": 3, "session": NEW}, "to anyone"),
        ({"controller": B}, "to another, in the session"),
        ({"controller": B, "incarnation": 1}, "to a former incarnation"),
        ({"controller": B, "incarnation": 1, "session": NEW}, "to another"),
        ({"instance": Q, "session": NEW}, "asked, new session"),
        ({"fingerprint": OTHER}, "another model"),
    ],
)
def test_a_hello_has_one_name(fields: dict[str, object], name: str) -> None:
    hello = HELLO.model_copy(update=fields)
    known: Any = {"instance": A, "fingerprint": OURS, "plant": P}
    assert event_of(hello, RECORD, running=False, **known) == name
    if hello.instance == Q and hello.session == NEW:
        assert event_of(hello, RECORD, running=True, **known) == "second plant"
    elif hello.instance == P:
        assert event_of(hello, RECORD, running=True, **known) == name


def test_without_an_offer_only_the_last_applied_fits() -> None:
    hello = HELLO.model_copy(update={"transitions": 1, "applied_k": 7})
    record = changed(RECORD, offer=None)
    known: Any = {"instance": A, "fingerprint": OURS, "plant": None, "running": False}
    assert event_of(hello, record, **known) == "asked, session does not fit"
    five = hello.model_copy(update={"applied_k": 5})
    assert event_of(five, record, **known) == "asked, session fits"


def test_another_model_is_the_end_for_who_never_met_one_of_its_own() -> None:
    hello = HELLO.model_copy(update={"controller": None, "fingerprint": OTHER})
    known: Any = {"instance": A, "fingerprint": OURS, "plant": None, "running": False}
    for record, name in (
        (controller_record(), "another model, never met"),
        (controller_record(ended=(T,)), "another model"),
        (controller_record(session=S), "another model"),
    ):
        assert event_of(hello, record, **known) == name
