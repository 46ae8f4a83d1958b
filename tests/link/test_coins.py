"""Which key a coin comes from, at one end alone: what is named, taken, asked for and erased."""

from random import Random

import pytest

from protocol.link.coins import AGAIN_S, BATCH, LACKING_S, AppliedCoins, OfferedCoins
from protocol.messages import Offer
from protocol.secret.key_digits import digits
from protocol.secret.records import Key
from protocol.secret.tasks import CoinKeys, CoinTask

SIZE = 2
DIGITS = 256
"""Of a key, for M = 2."""


def keys(number: int, first: int = 0) -> tuple[Key, ...]:
    return tuple(Key(f"k{i}", Random(i).randbytes(32)) for i in range(first, first + number))


def digit(key: int, place: int) -> int:
    return digits(keys(1, key)[0].key, SIZE)[place]


def offer(k: int, key: str | None, first: int | None, last: str | None = None) -> Offer:
    return Offer(
        session="0" * 16,
        k=k,
        candidates=((0.0,), (1.0,)),
        cipher=0,
        coin_key=key,
        coin_from=first,
        coin_last=key if last is None else last,
    )


def offered(number: int = 3, key: str = "", first: int = -1, applied: str = "") -> OfferedCoins:
    coins = OfferedCoins(SIZE, on=True)
    coins.begin("s", keys(number), key, first, applied)
    return coins


def applied(number: int = 3, key: str = "", first: int = -1) -> AppliedCoins:
    coins = AppliedCoins(SIZE, on=True)
    coins.begin("s", keys(number), key, first)
    return coins


# --- the controller's -----------------------------------------------------------------------------


def test_a_key_serves_to_its_last_digit_and_the_next_from_the_step_after() -> None:
    coins = offered(2)
    assert (coins.left, coins.key, coins.first) == (2, "", -1)
    named = {k: coins.named(k) for k in (7, 7 + DIGITS - 1, 7 + DIGITS, 6 + 2 * DIGITS)}
    assert named == {
        7: ("k0", 7, "k1"),
        7 + DIGITS - 1: ("k0", 7, "k1"),
        7 + DIGITS: ("k1", 7 + DIGITS, "k1"),
        6 + 2 * DIGITS: ("k1", 7 + DIGITS, "k1"),
    }
    assert coins.named(7 + 2 * DIGITS) == ("", 0, "k1")
    assert (coins.left, coins.key, coins.first) == (0, "k1", 7 + DIGITS)


@pytest.mark.parametrize(("key", "left"), [("", 3), ("k0", 2), ("k1", 1), ("k2", 0), ("gone", 0)])
def test_a_process_names_no_key_that_stands_before_the_newest(key: str, left: int) -> None:
    coins = offered(3, key, 4 if key else -1)
    assert coins.left == left
    expected = ("k0", 9, "k2") if not key else (key, 4, "k2") if key != "gone" else ("", 0, "k2")
    assert coins.named(9) == expected


def test_keys_from_the_offer_that_is_still_to_be_counted_on_are_held() -> None:
    coins = offered(4, "k2", 6, applied="k1")
    assert coins.left == 1
    assert coins.expected(offer(5, "k1", 3), "k1") == digit(1, 2)
    assert coins.expected(offer(5, "k0", 3), "k0") == -1
    assert coins.expected(offer(8, "k2", 6), "k2") == digit(2, 2)
    (task,) = coins.tasks(0.0)
    assert task == CoinTask("s", "k3", BATCH, ()), "k0 has served, and the last of those is kept"
    later = offered(4, "k3", 6, applied="k2")
    assert later.tasks(0.0) == (CoinTask("s", "k3", BATCH, ("k0",)),)


def test_where_the_newest_key_is_gone_none_of_those_held_is_named() -> None:
    coins = offered(4, "gone", 6, applied="k1")
    assert (coins.left, coins.named(9)) == (0, ("", 0, "k3"))
    assert coins.expected(offer(5, "k1", 3), "k1") == digit(1, 2)


def test_a_transition_is_watched_by_the_digit_of_its_step_alone() -> None:
    coins = offered(1, "k0", 3)
    for k, expected in ((2, -1), (3, digit(0, 0)), (2 + DIGITS, digit(0, -1)), (3 + DIGITS, -1)):
        assert coins.expected(offer(k, "k0", 3), "k0") == expected
    assert coins.expected(offer(3, "k0", 3), None) == -1
    assert coins.expected(offer(3, "k0", 3), "k1") == -1
    assert coins.expected(offer(3, "k0", None), "k0") == -1


def test_keys_are_asked_for_where_fewer_than_a_batch_are_ahead() -> None:
    coins = offered(BATCH + 1)
    assert coins.tasks(0.0) == ()
    coins.named(0)
    assert coins.tasks(0.0) == (), "a batch is ahead"
    coins.named(DIGITS)
    assert coins.tasks(0.0) == (CoinTask("s", f"k{BATCH}", BATCH, ()),)
    assert coins.tasks(0.0) == (), "it has asked"


def test_what_has_served_is_erased_but_the_last() -> None:
    coins = offered(4)
    for k in range(0, 4 * DIGITS, DIGITS):
        coins.named(k)
    assert coins.tasks(0.0) == (CoinTask("s", "k3", BATCH, ("k0", "k1")),)
    assert coins.expected(offer(0, "k1", 0), "k1") == -1
    assert coins.expected(offer(0, "k2", 0), "k2") == digit(2, 0)
    coins.done(CoinKeys("s", keys(1, 4)), 0.0)
    coins.named(4 * DIGITS)
    assert coins.tasks(0.0) == (CoinTask("s", "k4", BATCH, ("k2",)),)


def test_a_batch_that_is_not_marked_is_looked_for_after_a_while_and_not_before() -> None:
    coins = offered(0)
    assert coins.tasks(0.0), "at once"
    now, waits = 0.0, []
    for _ in range(6):
        coins.done(CoinKeys("s", pending=True), now)
        wait = coins.again_at - now
        assert coins.tasks(now + 0.999 * wait) == ()
        assert coins.tasks(now + wait) == (CoinTask("s", "", BATCH),)
        waits.append(round(wait, 6))
        now += wait
    assert waits == [AGAIN_S, 2 * AGAIN_S, 4 * AGAIN_S, 8 * AGAIN_S, LACKING_S, LACKING_S]
    coins.done(CoinKeys("s", keys(1), pending=True), now)
    assert coins.wait_s == AGAIN_S, "they are being marked"
    assert coins.left == 1


def test_keys_of_another_session_are_not_taken_and_one_may_ask_anew() -> None:
    coins = offered(0)
    coins.tasks(0.0)
    coins.done(CoinKeys("t", keys(2)), 0.0)
    assert coins.left == 0
    assert coins.tasks(AGAIN_S) == (CoinTask("s", "", BATCH),)


def test_a_store_that_has_nothing_is_not_asked_again_before_a_block_is_confirmed() -> None:
    coins = offered(1)
    assert coins.tasks(0.0)
    coins.done(CoinKeys("s"), 0.0)
    assert coins.tasks(1e9) == ()
    coins.confirmed()
    assert coins.tasks(1e9) == (CoinTask("s", "k0", BATCH),)
    coins.done(CoinKeys("s", keys(1, 1)), 1e9)
    assert coins.tasks(1e9) == (CoinTask("s", "k1", BATCH),), "there was one: there may be more"


def test_another_session_has_none_of_the_keys_of_the_one_before() -> None:
    coins = offered(3)
    coins.named(0)
    coins.tasks(0.0)
    coins.done(CoinKeys("s", pending=True), 0.0)
    coins.begin("t")
    assert (coins.left, coins.key, coins.first) == (0, "", -1)
    assert coins.named(1) == ("", 0, "")
    coins.done(CoinKeys("s", keys(2)), 0.0)
    assert coins.left == 0
    assert coins.tasks(LACKING_S) == (CoinTask("t", "", BATCH),)
    coins.begin(None)
    assert coins.tasks(1e9) == ()


def test_where_no_coin_is_keyed_nothing_is_held_named_or_asked() -> None:
    for coins in (OfferedCoins(SIZE, on=False), AppliedCoins(SIZE, on=False)):
        coins.begin("s", keys(3), "k0", 4)
        assert coins.tasks(0.0) == ()
        assert coins.digit_of(offer(4, "k0", 4)) is None
    off = OfferedCoins(SIZE, on=False)
    off.begin("s", keys(3))
    assert (off.left, off.named(0)) == (0, (None, None, None))


# --- the plant's ----------------------------------------------------------------------------------


def test_the_plant_takes_the_digit_of_the_step_and_binds_the_key() -> None:
    coins = applied()
    assert (coins.key, coins.first) == ("", -1)
    assert coins.digit(offer(7, "k0", 8)) is None, "it begins with a step to come"
    assert coins.key == ""
    assert coins.digit(offer(8, "k0", 8)) == digit(0, 0)
    assert (coins.key, coins.first) == ("k0", 8)
    assert coins.digit(offer(9, "k0", 9)) is None, "it is bound to another first step"
    assert coins.digit(offer(9, "k0", 8)) == digit(0, 1)
    assert coins.digit(offer(8 + DIGITS, "k0", 8)) is None
    assert coins.digit(offer(8, "", 0, "k2")) is None
    assert coins.digit(offer(8, None, None)) is None
    assert coins.digit(offer(8, "k1", None)) is None
    assert coins.digit(offer(300, "k2", 299)) == digit(2, 1)
    assert (coins.key, coins.first) == ("k2", 299)
    for left in ("k0", "k1"):
        assert coins.digit(offer(301, left, 301)) is None


@pytest.mark.parametrize("key", ["k0", "k1", "k2"])
def test_a_process_of_the_plants_takes_no_key_before_the_newest(key: str) -> None:
    coins = applied(3, key, 4)
    number = int(key[1])
    for i in range(3):
        first = 4 if i == number else 9
        expected = digit(i, 9 - first) if i >= number else None
        again = applied(3, key, 4)
        assert again.digit(offer(9, f"k{i}", first)) == expected
    coins.digit(offer(9, "", 0, "k9"))
    assert coins.tasks(0.0) == (CoinTask("s", "k2", 0, tuple(f"k{i}" for i in range(number))),)


def test_a_newest_key_that_is_gone_takes_those_that_were_held_along() -> None:
    coins = applied(3, "gone", 4)
    assert coins.digit(offer(9, "k2", 9)) is None
    coins.digit(offer(9, "", 0, "k9"))
    assert coins.tasks(0.0) == (CoinTask("s", "k2", 0, ("k0", "k1", "k2")),)


def test_the_plant_looks_for_keys_that_the_controller_holds_and_it_does_not() -> None:
    coins = applied(1)
    assert coins.tasks(0.0) == ()
    for last, name in (("k0", "k0"), ("", "k0"), ("", "")):
        coins.digit(offer(3, name, 3, last))
        assert coins.tasks(0.0) == ()
    coins.digit(offer(3, "k0", 3, "k1"))
    assert coins.tasks(0.0) == (CoinTask("s", "k0", 0, ()),)
    assert coins.tasks(0.0) == (), "it has asked"
    coins.done(CoinKeys("s"), 5.0)
    assert coins.tasks(5.0 + 0.999 * LACKING_S) == ()
    assert coins.tasks(5.0 + LACKING_S) == (CoinTask("s", "k0", 0, ()),)
    coins.done(CoinKeys("s", keys(1, 1)), 7.0)
    assert coins.tasks(7.0) == (), "that was it"
    coins.digit(offer(4, "k0", 3, "k2"))
    assert coins.tasks(7.0) == (CoinTask("s", "k1", 0, ()),), "at once"


def test_a_key_that_is_named_and_not_held_is_looked_for() -> None:
    for last in ("k5", ""):
        coins = applied(1)
        assert coins.digit(offer(3, "k5", 3, last)) is None
        assert coins.tasks(0.0) == (CoinTask("s", "k0", 0, ()),)


def test_keys_that_were_passed_over_are_erased_once() -> None:
    coins = applied(3)
    coins.digit(offer(3, "k0", 3))
    coins.digit(offer(4, "k2", 4, "k3"))
    assert coins.tasks(0.0) == (CoinTask("s", "k2", 0, ("k0", "k1")),)
    coins.done(CoinKeys("s"), 0.0)
    assert coins.tasks(LACKING_S) == (CoinTask("s", "k2", 0, ()),)


def test_another_session_of_the_plants_begins_with_nothing() -> None:
    coins = applied(3)
    coins.digit(offer(4, "k1", 4, "k9"))
    coins.begin("t")
    assert (coins.key, coins.first) == ("", -1)
    assert coins.tasks(1e9) == ()
    assert coins.digit(offer(4, "k2", 4)) is None
    assert coins.tasks(1e9) == (CoinTask("t", "", 0, ()),)
    coins.done(CoinKeys("s", keys(3)), 1e9)
    assert coins.digit(offer(5, "k2", 5)) is None
