"""The keyed coin through both real ends and stores as a state machine, and wrong ones it catches.

Keys are short here, five digits each, so that they change all the time.
"""

import itertools
from collections.abc import Callable, Iterator
from random import Random

import pytest
from hypothesis import HealthCheck, settings

from protocol.link import coins as coins_module
from protocol.link.coins import AppliedCoins, OfferedCoins
from protocol.messages import Offer
from protocol.secret import key_digits
from protocol.secret.records import Key
from protocol.secret.tasks import CoinKeys, CoinTask
from runtime.keys import coins
from runtime.keys.store import KeyStore
from tests.secret.test_keyed_link import KeyedLink, shaken
from tests.support.giving import agree, deliver, deliver_named
from tests.support.keyed_ends import KeyedEnds, keyed_rules
from tests.support.size import size
from tests.support.two_ends import SIDES

KEYED = keyed_rules(keyed=True)
DIGITS = 5


@pytest.fixture(autouse=True)
def short_keys() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coins_module, "digits", lambda k, size: key_digits.digits(k, size)[:DIGITS])
        yield


class KeyedCoinLink(KeyedLink):
    @staticmethod
    def begun() -> KeyedEnds:
        return KeyedEnds(KEYED)


TestKeyedCoinLink = KeyedCoinLink.TestCase
TestKeyedCoinLink.settings = settings(
    max_examples=size(8, 20),
    stateful_step_count=40,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)


def test_coins_are_keyed_and_watched_through_deaths() -> None:
    world = shaken(KeyedEnds(KEYED), 3)
    assert len({key for key, _ in world.digits.served}) > 10
    assert len(world.digits.watched) > 100
    taken = {key for key, _ in world.digits.served}
    for side in SIDES:
        held = {name for name, body in world.stores[side].compare().items() if body is not None}
        left = [key for key in taken if key not in held]
        assert len(left) > len(taken) / 3, "what has served is erased, a batch at a time"
    world.close()


def take_from_any_step(patch: pytest.MonkeyPatch) -> None:
    """The plant binds no key to its first step."""
    bound = AppliedCoins.digit

    def digit(self: AppliedCoins, offer: Offer) -> int | None:
        bound(self, offer)  # which asks for the keys that it lacks
        return self.digit_of(offer)

    patch.setattr(AppliedCoins, "digit", digit)


def by_transitions(patch: pytest.MonkeyPatch) -> None:
    """A digit for each transition, and not for each step: a missed step's is used later."""
    named = OfferedCoins.named

    def next_digit(self: OfferedCoins, k: int) -> tuple[str | None, int | None, str | None]:
        key, first, newest = named(self, k)
        served = getattr(self, "served", -1) + 1
        self.served = served  # type: ignore[attr-defined]
        return key, first if not key else k - served % DIGITS, newest

    patch.setattr(OfferedCoins, "named", next_digit)
    take_from_any_step(patch)


def every_process_begins_with_the_first_key(patch: pytest.MonkeyPatch) -> None:
    begin = OfferedCoins.begin
    patch.setattr(
        OfferedCoins,
        "begin",
        lambda self, session, keys=(), key="", first=-1, applied="": begin(self, session, keys),
    )
    take_from_any_step(patch)


def the_plant_says_that_every_coin_is_keyed(patch: pytest.MonkeyPatch) -> None:
    from plant_service.core import PlantCore

    patch.setattr(
        PlantCore, "said_key", lambda self, key, *, keyed: key if self.rules.keyed else None
    )


WRONG: list[Callable[[pytest.MonkeyPatch], None]] = [
    by_transitions,
    every_process_begins_with_the_first_key,
    the_plant_says_that_every_coin_is_keyed,
]


@pytest.mark.wrong_on_purpose
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_one_is_caught(wrong: Callable[[pytest.MonkeyPatch], None]) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(AssertionError):
        wrong(patch)
        for seed in range(8):
            shaken(KeyedEnds(KEYED), seed).close()


# --- the stores -----------------------------------------------------------------------------------


@pytest.fixture
def stores() -> Iterator[tuple[KeyStore, KeyStore]]:
    """Of a world whose keys nobody has taken."""
    world = KeyedEnds(keyed_rules())
    world.well(200)
    yield world.stores["controller"], world.stores["plant"]
    world.close()


def given(
    stores: tuple[KeyStore, KeyStore], session: str, number: int
) -> tuple[CoinKeys, CoinKeys]:
    controller, plant = stores
    assert coins.serve(controller, CoinTask(session, "", number)).pending
    agree(controller, plant)
    return coins.serve(controller, CoinTask(session, "")), coins.serve(plant, CoinTask(session, ""))


def test_both_ends_get_the_same_keys_in_one_order(stores: tuple[KeyStore, KeyStore]) -> None:
    mine, theirs = given(stores, "a", 4)
    assert mine.keys == theirs.keys
    assert len(mine.keys) == 4
    later, _ = given(stores, "a", 3)
    assert later.keys[:4] == mine.keys
    assert coins.serve(stores[1], CoinTask("a", mine.keys[-1].key_id)).keys == later.keys[4:]


def test_a_key_of_the_coin_is_given_for_nothing_else(stores: tuple[KeyStore, KeyStore]) -> None:
    controller, plant = stores
    mine, _ = given(stores, "a", 3)
    names = {key.key_id for key in mine.keys}
    every = deliver(controller, controller.available(), partner=plant)
    assert not names & {key.key_id for key in every}
    with pytest.raises(Exception, match="not in this store"):
        deliver_named(plant, sorted(names), partner=controller)


def test_keys_that_have_served_and_those_of_other_sessions_are_erased(
    stores: tuple[KeyStore, KeyStore],
) -> None:
    mine, _ = given(stores, "a", 3)
    first = mine.keys[0].key_id
    for store in stores:
        left = coins.serve(store, CoinTask("a", "", served=(first,))).keys
        assert left == mine.keys[1:]
        assert coins.serve(store, CoinTask("b", "")).keys == ()
        assert all(store.compare()[key.key_id] is None for key in mine.keys)


def test_a_plant_takes_nothing_that_was_not_marked(stores: tuple[KeyStore, KeyStore]) -> None:
    controller, plant = stores
    coins.serve(controller, CoinTask("a", "", 2))
    assert coins.serve(controller, CoinTask("a", "", 2)) == CoinKeys("a", (), True)
    assert coins.serve(plant, CoinTask("a", "")).keys == ()


# --- one end by itself ----------------------------------------------------------------------------


def keys(number: int) -> list[Key]:
    return [Key(f"k{i}", Random(i).randbytes(32)) for i in range(number)]


def offer(k: int, key: str, first: int) -> Offer:
    return Offer(
        session="0" * 16,
        k=k,
        candidates=((0.0,), (1.0,)),
        cipher=0,
        coin_key=key,
        coin_from=first,
        coin_last=key,
    )


def test_the_plant_binds_a_key_to_its_first_step_and_takes_none_that_was_left() -> None:
    plant = AppliedCoins(2, on=True)
    plant.begin("s", keys(3))
    digits = [key_digits.digits(key.key, 2) for key in keys(3)]
    assert plant.digit(offer(7, "k1", 5)) == digits[1][2]
    assert plant.digit(offer(8, "k1", 6)) is None
    assert plant.digit(offer(8, "k0", 8)) is None
    assert plant.digit(offer(9, "k1", 5)) == digits[1][4]
    assert plant.digit(offer(10, "k1", 5)) is None  # it has five
    assert plant.digit(offer(11, "k2", 12)) is None
    assert plant.digit(offer(12, "k2", 12)) == digits[2][0]
    assert plant.digit(offer(13, "k1", 9)) is None


def test_a_plant_that_holds_newer_keys_than_the_controller_does_not_look_for_more() -> None:
    plant = AppliedCoins(2, on=True)
    plant.begin("s", keys(1))

    def offered(k: int, newest: str) -> tuple[CoinTask, ...]:
        plant.digit(offer(k, "k0", 0).model_copy(update={"coin_last": newest}))
        return plant.tasks(10.0 * k)

    assert offered(0, "k0") == ()
    assert offered(1, "k1") == (CoinTask("s", "k0", 0, ()),)
    plant.done(CoinKeys("s", tuple(keys(4)[1:])), 10.0)
    assert [offered(k, f"k{k - 1}") for k in range(2, 5)] == [()] * 3  # it has k3 already
    assert offered(5, "k4") == (CoinTask("s", "k3", 0, ()),)


def test_what_cannot_be_agreed_is_unwatched() -> None:
    controller = OfferedCoins(2, on=True)
    controller.begin("s", keys(1))
    assert controller.named(3) == ("k0", 3, "k0")
    said = offer(3, "k0", 3)
    assert controller.expected(said, "k0") == key_digits.digits(keys(1)[0].key, 2)[0]
    assert controller.expected(said, "") == -1
    assert controller.expected(said, "k9") == -1
    assert controller.named(3 + DIGITS) == ("", 0, "k0")
    controller.begin("t")
    assert controller.expected(said, "k0") == -1


def test_a_batch_that_nobody_marks_is_asked_after_ever_less_often() -> None:
    controller = OfferedCoins(2, on=True)
    controller.begin("s")
    asked, now = [], 0.0
    for _ in range(1000):
        now += 0.01
        if controller.tasks(now):
            asked.append(now)
            controller.done(CoinKeys("s", pending=True), now)
    assert [round(b - a, 1) for a, b in itertools.pairwise(asked)][:5] == [0.1, 0.2, 0.4, 0.8, 1.0]
    controller.done(CoinKeys("s", tuple(keys(2))), now)
    assert controller.tasks(now + 0.01) == (CoinTask("s", "k1", 32),)


def test_an_empty_store_is_asked_again_once_a_block_is_confirmed() -> None:
    controller = OfferedCoins(2, on=True)
    controller.begin("s")
    assert controller.tasks(0.0)
    controller.done(CoinKeys("s"), 0.0)
    assert controller.tasks(100.0) == ()
    controller.confirmed()
    assert controller.tasks(100.0)


def test_keys_serve_in_the_order_in_which_they_came_and_more_come_after_those_held() -> None:
    controller = OfferedCoins(2, on=True)
    controller.begin("s", keys(1))
    controller.tasks(0.0)
    controller.done(CoinKeys("s", tuple(keys(3)[1:])), 0.0)
    assert controller.left == 3
    named = [controller.named(k)[:2] for k in range(0, 4 * DIGITS, DIGITS)]
    assert named == [("k0", 0), ("k1", DIGITS), ("k2", 2 * DIGITS), ("", 0)]


def test_a_scenario_without_it_says_nothing() -> None:
    assert OfferedCoins(2, on=False).named(3) == (None, None, None)
