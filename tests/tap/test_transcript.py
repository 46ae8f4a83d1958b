"""Public messages to transitions: whatever the order, never a wrong number, holes where due."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.messages import Measurement, Offer
from tap_service.capture.transcript import (
    CONFIRMED,
    LONGEST_BRIDGE,
    ONE_SIDED_PATIENCE,
    UNHEARD_PATIENCE,
    Transcript,
    Transition,
    Unused,
)

A, B, C = "a" * 16, "b" * 16, "c" * 16


def measurement(k: int, applied: int, session: str = A) -> Measurement:
    after = (float(applied + 1), -1.0) if applied >= 0 else ()
    return Measurement(session=session, k=k, x=(float(k), -1.0), applied_k=applied, x_after=after)


def offer(k: int, session: str = A) -> Offer:
    return Offer(session=session, k=k, candidates=((float(k),), (k + 0.5,)), cipher=k % 2)


def lock_step(steps: int, missed: frozenset[int] = frozenset()) -> list[Measurement | Offer]:
    """A loop in which the plant got no offer in time at the steps ``missed``."""
    out: list[Measurement | Offer] = []
    applied = -1
    for k in range(steps):
        out.append(measurement(k, applied))
        out.append(offer(k))
        if k not in missed:
            applied = k
    return [*out, measurement(steps, applied)]


def of_session(session: str, messages: list[Measurement | Offer]) -> list[Measurement | Offer]:
    return [m.model_copy(update={"session": session}) for m in messages]


def hear(messages: list[Measurement | Offer]) -> list[Transition]:
    transcript = Transcript()
    return [t for m in messages for t in transcript.hear(m)] + transcript.flush()


def check_numbers(t: Transition) -> None:
    assert t.x in (None, (float(t.k), -1.0))
    assert t.x_next in (None, (float(t.k + 1), -1.0))
    assert t.candidates in (None, ((float(t.k),), (t.k + 0.5,)))
    assert t.cipher in (None, t.k % 2)


@pytest.mark.parametrize("far", [5, 30, 60])
def test_a_message_ahead_of_its_place_costs_no_transition(far: int) -> None:
    """It came by a shorter way, or was forged: the steps that it overtook are not over."""
    messages = lock_step(200)
    for at in (240, 100):
        messages[at:at] = [measurement(at // 2 + far, at // 2 + far - 1), offer(at // 2 + far)]
    found = hear(messages)
    assert [t.k for t in found] == list(range(200))
    assert all(t.whole for t in found)


def test_lock_step_gives_every_transition_as_soon_as_it_is_known() -> None:
    transcript = Transcript()
    for message in lock_step(20):
        finished = transcript.hear(message)
        if isinstance(message, Measurement) and message.k:
            assert [t.k for t in finished] == [message.k - 1]
            assert finished[0].whole
            assert finished[0].applied
            assert finished[0].start == (message.k == 1)
        else:
            assert not finished


@given(st.frozensets(st.integers(0, 29)))
def test_missed_steps_are_no_transitions(missed: frozenset[int]) -> None:
    heard = hear(lock_step(30, missed))
    assert [t.k for t in heard] == [k for k in range(30) if k not in missed]
    assert all(t.whole for t in heard)


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.frozensets(st.integers(0, 59), max_size=10))
def test_two_senders_in_any_relative_order_and_twice(seed: int, missed: frozenset[int]) -> None:
    rng = random.Random(seed)
    messages = lock_step(60, missed)
    streams = [[m for m in messages if isinstance(m, kind)] for kind in (Measurement, Offer)]
    mixed: list[Measurement | Offer] = []
    while any(streams):
        stream = rng.choice([s for s in streams if s])
        mixed += [stream[0]] * rng.choice((1, 1, 2))
        stream.pop(0)
    heard = hear(mixed)
    assert heard == hear(messages)


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.floats(0.0, 0.7))
def test_losses_leave_holes_and_never_a_wrong_number(seed: int, loss: float) -> None:
    rng = random.Random(seed)
    heard = hear([m for m in lock_step(80) if rng.random() >= loss])
    steps = [t.k for t in heard]
    assert steps == sorted(set(steps))
    for t in heard:
        check_numbers(t)
        assert t.applied == (t.x_next is not None)


def test_a_lost_message_costs_holes_in_its_own_steps_only() -> None:
    messages = [m for m in lock_step(40) if not (isinstance(m, Measurement) and m.k == 20)]
    heard = hear(messages)
    assert [t.k for t in heard] == list(range(40))
    assert [t.k for t in heard if not t.whole] == [19, 20]
    assert heard[19].x_next is None
    assert heard[20].x is None


def test_what_was_not_heard_of_one_of_the_last_steps_is_a_hole_too() -> None:
    unheard = [m for m in lock_step(10) if m != offer(7) and m != measurement(8, 7)]
    assert [(t.k, t.whole) for t in hear(unheard)] == [(k, k not in (7, 8)) for k in range(10)]


def test_one_direction_alone_is_given_out_after_a_short_wait() -> None:
    offers = [m for m in lock_step(100) if isinstance(m, Offer)]
    transcript = Transcript()
    given_out = [t for m in offers for t in transcript.hear(m)]
    assert [t.k for t in given_out] == list(range(100 - UNHEARD_PATIENCE))
    assert all(t.x is None and t.candidates is not None and not t.applied for t in given_out)


def test_at_the_end_of_offers_alone_the_next_offer_confirms_the_last() -> None:
    offers: list[Measurement | Offer] = [m for m in lock_step(100) if isinstance(m, Offer)]
    heard = hear(offers)
    assert [t.k for t in heard] == list(range(99))
    assert not any(t.applied for t in heard)
    assert hear(offers[:1]) == []
    assert hear([]) == []


def test_a_sender_who_falls_silent_is_waited_for_a_bounded_time() -> None:
    transcript = Transcript()
    for m in lock_step(3):
        transcript.hear(m)
    given_out = []
    for k in range(4, ONE_SIDED_PATIENCE + 20):
        given_out += transcript.hear(measurement(k, k - 1))
    assert given_out
    assert all(t.candidates is None for t in given_out)


def test_a_new_session_starts_afresh_and_the_old_one_is_over() -> None:
    transcript = Transcript()
    heard = [t for m in lock_step(10) for t in transcript.hear(m)]
    second = of_session(B, lock_step(CONFIRMED))
    second.insert(1, offer(10, A))  # its connection was slower
    heard += [t for m in second for t in transcript.hear(m)]
    steps = [(A, k) for k in range(10)] + [(B, k) for k in range(CONFIRMED)]
    assert [(t.session, t.k) for t in heard] == steps
    assert [t.k for t in heard if t.start] == [0, 0]
    assert transcript.hear(offer(11, A)) == []
    assert transcript.unused == Unused(foreign=1)


def test_a_session_that_ends_soon_after_it_began_is_heard_too() -> None:
    second: list[Measurement | Offer] = [
        measurement(0, -1, B),
        offer(0, B),
        measurement(1, 0, B),
    ]
    heard = hear([*lock_step(10), *second])
    assert [(t.session, t.k) for t in heard] == [(A, k) for k in range(10)] + [(B, 0)]
    third = of_session(C, lock_step(20))
    heard = hear([*lock_step(10), *second, *third])
    assert [(t.session, t.k) for t in heard][10:] == [(B, 0), *((C, k) for k in range(20))]


STRAYS: list[Measurement | Offer] = [
    measurement(5, 4, B),
    measurement(0, -1, B),
    offer(5, B),
    measurement(10**9, 10**9 - 1),
    measurement(2000, 1),
    measurement(2000, 1999),
    offer(3000),
    offer(10**9),
]


@pytest.mark.parametrize("at", [0, 1, 40, 41, 400])
@pytest.mark.parametrize("stray", STRAYS)
def test_one_stray_message_costs_nothing_and_is_counted(
    stray: Measurement | Offer, at: int
) -> None:
    """One of another session ended the true one: 1,000 steps later there was no transition."""
    messages = lock_step(200)
    transcript = Transcript()
    heard = [t for m in (*messages[:at], stray, *messages[at:]) for t in transcript.hear(m)]
    heard += transcript.flush()
    assert heard == hear(messages)
    assert transcript.unused == Unused(foreign=1)


def test_a_stray_before_its_session_is_followed_costs_nothing() -> None:
    """It is of the second session, and came while the first was followed."""
    second = of_session(B, lock_step(100))
    for stray in (measurement(100, 99, B), offer(30, B), measurement(200, 1, B)):
        first = lock_step(10)
        assert hear([*first[:9], stray, *first[9:], *second]) == hear([*first, *second])


def test_strays_again_and_again_cost_nothing_either() -> None:
    messages = lock_step(1000)
    transcript = Transcript()
    heard = []
    for i, message in enumerate(messages):
        heard += transcript.hear(message)
        heard += transcript.hear(STRAYS[i % len(STRAYS)])
        heard += transcript.hear(offer(i, f"{i % 7:016x}"))
    heard += transcript.flush()
    assert heard == hear(messages)
    assert transcript.unused.foreign > len(messages)
    assert transcript.unused.late == transcript.unused.jumped == 0
    assert transcript.sessions == 1


def test_a_session_that_was_taken_for_over_is_followed_again() -> None:
    first, second = lock_step(200), lock_step(60)
    heard = hear([*first[:200], *of_session(B, second), *first[200:]])
    assert [t.session for t in heard] == [A] * 99 + [B] * 60 + [A] * 100
    assert [t.k for t in heard if t.session == A] == [*range(99), *range(100, 200)]
    assert [t.k for t in heard if t.gap] == [100]
    assert [t.k for t in heard if t.start] == [0, 0]


def test_what_comes_after_its_step_was_given_out_is_counted_and_a_repeat_is_not() -> None:
    messages = lock_step(40)
    slow = [m for m in messages if isinstance(m, Offer) and m.k in (10, 11)]
    transcript = Transcript()
    for message in messages:
        if message not in slow:
            transcript.hear(message)
    assert transcript.holes == 2
    for message in (*slow, *slow, *messages):
        assert transcript.hear(message) == []
    assert transcript.unused == Unused(late=2)


def test_joining_late_and_long_gaps_are_marked() -> None:
    transcript = Transcript()
    late = [t for m in lock_step(100)[120:] for t in transcript.hear(m)]
    assert not late[0].start
    assert late[0].gap
    far = 10 * LONGEST_BRIDGE
    after = [*transcript.hear(measurement(far, far - 1)), *transcript.hear(offer(far))]
    after += transcript.hear(measurement(far + 1, far))
    after += transcript.hear(offer(far + 1))
    for k in range(far + 2, far + 20):
        after += transcript.hear(measurement(k, k - 1))
        after += transcript.hear(offer(k))
    assert transcript.unused.jumped > 0
    assert any(t.gap for t in after)
    assert [t.k for t in after if t.whole][-1] == far + 18


def test_memory_is_bounded_whatever_comes() -> None:
    transcript = Transcript()
    rng = random.Random(1)
    for _ in range(20_000):
        k = rng.randrange(10**9)
        transcript.hear(offer(k) if rng.random() < 0.5 else measurement(k, k - 1))
    assert transcript.held < 8 * LONGEST_BRIDGE
