"""The plant's table of a session is whole, and what a hello is called follows from the record."""

import pytest

from protocol.link.plant_session import (
    TABLE,
    event_of,
)
from protocol.messages import ControllerHello
from tests.support.records import changed, plant_record

S, T = "1" * 16, "2" * 16
A, B, P, Q = (letter * 16 for letter in "abcd")
OURS, OTHER = "e" * 64, "f" * 64
RECORD = plant_record(session=S, k=3, x=(0.0,), u=(0.0,), controller=A, incarnation=2)


@pytest.mark.parametrize("transitions", [0, 5])
@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"instance": A}, "greeting of the one asked"),
        ({"instance": A, "session": T}, "greeting of the one asked"),
        ({"instance": A, "incarnation": 1}, "greeting of a former incarnation"),
        ({"instance": B, "incarnation": 1}, "greeting of a former incarnation"),
        ({"instance": B, "incarnation": 2}, "greeting in the session"),
        ({"instance": B, "incarnation": 3}, "greeting in the session"),
        ({"instance": B, "incarnation": 1, "session": T}, "greeting in another"),
        ({"instance": B, "session": None}, "greeting in another"),
        ({"verdict": "accepted", "answers": P}, "accepted"),
        ({"verdict": "unknown-session", "answers": P}, "unknown session"),
        ({"verdict": "accepted", "answers": P, "instance": B}, "answer of another"),
        ({"verdict": "accepted", "answers": Q}, "answer to another"),
        ({"verdict": "unknown-session", "answers": P, "session": T}, "answer to another"),
        ({"fingerprint": OTHER}, "another model"),
        ({"fingerprint": OTHER, "verdict": "other-model"}, "another model"),
    ],
)
def test_a_hello_has_one_name(fields: dict[str, object], name: str, transitions: int) -> None:
    hello = ControllerHello(
        instance=A, incarnation=2, fingerprint=OURS, verdict="greeting", session=S
    ).model_copy(update=fields)
    record = changed(RECORD, transitions=transitions)
    if name == "greeting in another" and not transitions:
        name = "greeting, session unused"
    told = event_of(hello, record, instance=P, fingerprint=OURS, asked=A, met=True)
    assert told == name


def test_whose_session_it_is_decides_whether_another_begins_anew() -> None:
    hello = ControllerHello(instance=B, incarnation=1, fingerprint=OURS, verdict="greeting")
    for promised, name in (
        ("", "greeting in another"),
        (B, "greeting in another"),
        (A, "greeting, session unused"),
    ):
        record = changed(RECORD, controller=promised)
        told = event_of(hello, record, instance=P, fingerprint=OURS, asked=None, met=False)
        assert told == name


def test_another_model_is_the_end_for_who_never_met_one_of_its_own() -> None:
    hello = ControllerHello(instance=B, incarnation=1, fingerprint=OTHER, verdict="greeting")
    told = event_of(hello, RECORD, instance=P, fingerprint=OURS, asked=None, met=False)
    assert told == "another model, never met"
    assert TABLE["looking", told] == ("give up", "refused")
