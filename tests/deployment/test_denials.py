"""What a guarded router tells of messages that it did not let in."""

import logging
import os

import pytest

from runtime.logs import RateLimitedLog
from wyner.deployment.denials import SESSIONS, Denials, denials_told

KEY = "wyner/v2/loop/measurement"
KINDS = ("Query", "Reply", "Put", "Delete", "Declare/Undeclare Subscriber", "Liveliness Query")
TAP, PLANT = "46ac7b82", "60a53478"


def line(said: str, thread: int = 9) -> str:
    """As Zenoh 1.10 writes it, colours included."""
    return (
        f"\x1b[2m2026-11-22T22:36:52Z\x1b[0m \x1b[35mTRACE\x1b[0m  rx-1 ThreadId({thread:02}) "
        f"\x1b[2mzenoh::net::routing::interceptor::access_control\x1b[0m\x1b[2m:\x1b[0m {said}\n"
    )


def judged(zid: str, name: str, what: str, verdict: str = "unauthorized", key: str = KEY) -> str:
    subject = f"Interface(lo)+CertCommonName({name})+Transport(Tls)+{zid}"
    return f"{zid} on {subject} is {verdict} to {what} on {key}"


def in_advance(zid: str, name: str, flow: str = "ingress") -> list[str]:
    return [
        f"ACL ({flow}): caching permissions for `{KEY}` ...",
        *(judged(zid, name, f"{kind} ({flow})") for kind in KINDS),
    ]


def told(*lines: str) -> list[str]:
    denials = Denials()
    return [text for text in map(denials.read, lines) if text]


def test_what_is_judged_in_advance_was_sent_by_nobody() -> None:
    assert told(*map(line, in_advance(TAP, "tap") + in_advance(TAP, "tap", "egress"))) == []


def test_a_message_that_is_judged_as_before_is_told_by_its_name() -> None:
    again = f"Using cached result: {TAP} is unauthorized to Put (ingress) on {KEY}"
    said = told(*map(line, [*in_advance(TAP, "tap"), again, again]))
    assert said == [f"denied: tap may not put on {KEY}"] * 2


def test_two_threads_judge_at_the_same_time() -> None:
    """One judges in advance for the tap while another judges a message of the plant's."""
    mixed = [line(said, 8) for said in in_advance(TAP, "tap")]
    mixed.insert(3, line(judged(PLANT, "plant", "Put (ingress)"), 9))
    assert told(*mixed) == [f"denied: plant may not put on {KEY}"]


@pytest.mark.parametrize("verb", ["Put", "Delete"])
def test_a_message_that_is_judged_now_is_told(verb: str) -> None:
    now = judged(TAP, "tap", f"{verb} (ingress)")
    assert told(line(now)) == [f"denied: tap may not {verb.lower()} on {KEY}"]
    assert told(*map(line, [*in_advance(TAP, "tap"), now])) == [
        f"denied: tap may not {verb.lower()} on {KEY}"
    ], "and also on the thread that has just judged the same key in advance"
    other = judged(TAP, "tap", f"{verb} (ingress)", key="wyner/v2/loop/offer")
    assert told(*map(line, [*in_advance(TAP, "tap")[:2], other, now])) == [
        f"denied: tap may not {verb.lower()} on wyner/v2/loop/offer",
        f"denied: tap may not {verb.lower()} on {KEY}",
    ], "a line for another key ends what is judged in advance"


@pytest.mark.parametrize(
    "said",
    [
        judged(PLANT, "plant", "Put (ingress)", "authorized"),
        judged(TAP, "tap", "Put (egress)"),
        judged(TAP, "tap", "Declare/Undeclare Subscriber (ingress)"),
        f"Using cached result: {TAP} is authorized to Put (ingress) on {KEY}",
        f"Using cached result: {TAP} is unauthorized to Put (egress) on {KEY}",
        "Policy enforcement is on",
    ],
)
def test_what_was_let_in_or_is_no_message_is_not_told(said: str) -> None:
    assert told(line(said)) == []


def test_a_session_without_a_name_is_told_too() -> None:
    again = f"Using cached result: {TAP} is unauthorized to Put (ingress) on {KEY}"
    assert told(line(again)) == [f"denied: who has no name in the rules may not put on {KEY}"]


def test_lines_of_others_and_torn_lines_are_passed_over() -> None:
    whole = line(judged(TAP, "tap", "Put (ingress)"))
    assert told("", "\n", "no line of Zenoh's", whole[:60], whole[-40:]) == []


def test_the_names_of_sessions_are_bounded() -> None:
    denials = Denials()
    for n in range(SESSIONS + 1):
        denials.read(line(judged(f"{n:x}", "tap", "Put (ingress)")))
    first, last = (
        denials.read(line(f"Using cached result: {n:x} is unauthorized to Put (ingress) on {KEY}"))
        for n in (0, SESSIONS)
    )
    assert "no name" in first
    assert "tap may not" in last


def test_the_last_denials_are_told_with_their_count_at_the_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    said = "".join([line(judged(TAP, "tap", "Put (ingress)"))] * 5)
    complaints = RateLimitedLog(logging.getLogger("test-denials"))
    with denials_told(complaints):
        os.write(1, said.encode())
    denied = f"denied: tap may not put on {KEY}"
    assert complaints.total == 5
    assert [r.message for r in caplog.records] == [
        denied,
        f"{denied} (and 3 more since the last such line)",
    ]
