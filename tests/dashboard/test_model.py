"""The state and the scores: pure, bounded, and right about who knows what."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.messages import ControllerStatus, PlantStatus, TapStatus
from protocol.statistics import bits_left, stated_left
from protocol.topics import key_of
from runtime.inbox import OVERHEAD
from tests.dashboard.states import batches, plant_of, state_after, with_plant
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.rehearsal import MESSAGE_TEXT
from tests.support.statuses import changed
from wyner.dashboard import source as source_module
from wyner.dashboard.headless import secrecy_line
from wyner.dashboard.model import (
    PICTURE_NS,
    STEPS_KEPT,
    TAPS_KEPT,
    Arrival,
    LoopState,
    reduce,
    reduce_all,
)
from wyner.dashboard.score import (
    ALARM,
    SecrecyScore,
    characters_right,
    ranked,
    score,
    secrecy,
    truth_for,
)
from wyner.dashboard.source import BusSource


def with_tap(state: LoopState, name: str, **changes: object) -> LoopState:
    tap = state.taps["list-decoder"].status
    at = {"seq": tap.seq + 1, "t_ns": tap.t_ns + 1}
    later = changed(tap, **{"name": name, **at, **changes})
    return reduce(state, Arrival(state.seen["plant"] + 1, later))


# --- the reducer -------------------------------------------------------------------------------


@given(st.permutations(range(8)))
def test_late_statuses_change_nothing_whatever_their_order(order: list[int]) -> None:
    first = batches(100)[:8]
    ordered = reduce_all(LoopState(), (a for batch in first for a in batch))
    mixed = reduce_all(ordered, (a for i in order for a in first[i]))
    assert mixed == replace(ordered, received=mixed.received)


def test_a_restarted_service_is_believed_although_it_counts_from_zero() -> None:
    state = state_after(100)
    plant = plant_of(state)
    again = changed(plant, seq=0, t_ns=plant.t_ns + 5, step={"k": 1})
    assert plant_of(reduce(state, Arrival(1, again))).step.k == 1


def test_a_new_session_voids_what_was_known_by_step() -> None:
    state = with_plant(state_after(100), session="f" * 16, secrets={"tail": ()})
    assert state.truths == {}
    assert all(tap.guesses == {} for tap in state.taps.values())


def test_a_true_state_is_that_after_the_step_that_led_to_it() -> None:
    state = state_after(100)
    last = plant_of(state).secrets.tail[-1]._replace(true_x_next=(9.0, -9.0))
    state = with_plant(state, secrets={"tail": (last,)})
    x = plant_of(state).step.x
    assert state.away == max(abs(9.0 - x[0]), abs(9.0 + x[1]))
    missed = with_plant(state, step={"k": 101, "x": (50.0, 50.0)})
    assert missed.away == 0, "of the step before nothing true was told"


def test_the_board_stays_bounded() -> None:
    state = state_after(6000)
    plant = plant_of(state)
    fewest = STEPS_KEPT - STEPS_KEPT // 8
    for held in (state.truths, *(tap.guesses for tap in state.taps.values())):
        assert fewest <= len(held) <= STEPS_KEPT
        assert set(range(plant.step.k - fewest, plant.step.k)) <= held.keys()
    for i in range(TAPS_KEPT + 5):
        state = with_tap(state, f"tap-{i}")
    assert len(state.taps) == TAPS_KEPT
    assert state.malformed == 5 + 3


def test_recovered_is_a_prefix_of_sent_all_the_way() -> None:
    state = LoopState()
    for batch in batches(2000):
        state = reduce_all(state, batch)
        assert state.sent == MESSAGE_TEXT
        assert MESSAGE_TEXT.startswith(state.recovered)
    assert state.recovered == MESSAGE_TEXT


# --- automata ----------------------------------------------------------------------------------


def test_a_pictured_step_stays_half_a_second_unless_an_agreement_comes() -> None:
    state = state_after(200)
    assert state.pictured is not None
    start = state.seen["plant"] + 10**9

    def after(state: LoopState, k: int, symbol: int, t_ns: int) -> tuple[LoopState, int]:
        plant = plant_of(state)
        secrets = {"pictured": {"k": k, "symbol": symbol}}
        status = changed(plant, seq=plant.seq + 1, secrets=secrets)
        state = reduce(state, Arrival(t_ns, status))
        assert state.pictured is not None
        return state, state.pictured.k

    state, shown = after(state, 1000, -1, start)
    assert shown == 1000
    state, shown = after(state, 1001, -1, start + 10)
    assert shown == 1000
    state, shown = after(state, 1002, 1, start + 20)
    assert shown == 1002
    state, shown = after(state, 1003, 0, start + 30)
    assert shown == 1002
    state, shown = after(state, 1004, -1, start + 20 + PICTURE_NS)
    assert shown == 1004


# --- scores ------------------------------------------------------------------------------------


def test_scores_count_agreed_steps_only() -> None:
    state = state_after(500)
    agreed = [t for t in state.truths.values() if t.symbol >= 0]
    its = score(state, state.taps["nearest-centre"])
    assert (its.of, its.right) == (len(agreed), len(agreed))
    blind = score(state, state.taps["set-membership"])
    assert blind.of == len(agreed)
    assert blind.right == sum(
        t.symbol == state.taps["set-membership"].guesses[k].symbol
        for k, t in state.truths.items()
        if t.symbol >= 0
    )


def test_a_revised_guess_replaces_the_first_one() -> None:
    state = state_after(500)
    tap = state.taps["list-decoder"].status
    flipped = tuple(guess._replace(symbol=1 - guess.symbol) for guess in tap.tail)
    after = with_tap(state, "list-decoder", tail=flipped)
    revised = [guess for guess in tap.tail if state.truths[guess.k].symbol >= 0]
    before = score(state, state.taps["list-decoder"]).right
    assert score(after, after.taps["list-decoder"]).right == before - len(revised)


def test_a_few_steps_prove_nothing() -> None:
    state = state_after(10)
    its = score(state, state.taps["nearest-centre"])
    assert 0 < its.right == its.of < 8
    assert not its.better_than_chance(ALARM)
    assert bits_left(1, 2, its.share).high > 0.4
    assert not secrecy(state).exceeds


def test_a_tap_that_guesses_every_symbol_leaves_little() -> None:
    state = state_after(500)
    its = secrecy(replace(state, taps={"nearest-centre": state.taps["nearest-centre"]}))
    assert its.claimed_bits == plant_of(state).step.agreements
    assert its.exceeds
    assert its.left is not None
    assert its.left.value == 0
    assert 0 < its.left.high < 0.15 * its.claimed_bits


def test_what_is_forgotten_still_counts_once_and_in_every_session() -> None:
    """An alarm over a window that moves on would be lit by chance sooner or later."""
    state = LoopState()
    scored: dict[int, bool] = {}
    for batch in batches(6000):
        state = reduce_all(state, batch)
        tap = state.taps.get("nearest-centre")
        for k, guess in {} if tap is None else tap.guesses.items():
            if (truth := state.truths.get(k)) is not None and truth.symbol >= 0:
                scored[k] = guess.symbol == truth.symbol
    its = score(state, state.taps["nearest-centre"])
    assert its.of == len(scored) > sum(t.symbol >= 0 for t in state.truths.values())
    assert its.right == sum(scored.values())
    other = with_plant(state, session="f" * 16, secrets={"tail": ()})
    assert score(other, other.taps["nearest-centre"]) == its


def test_one_who_failed_or_does_not_guess_is_not_scored() -> None:
    state = state_after(500)
    alone = replace(state, taps={"nearest-centre": state.taps["nearest-centre"]})

    def told(**changes: object) -> SecrecyScore:
        tap = alone.taps["nearest-centre"]
        told = replace(tap, status=changed(tap.status, **changes))
        return secrecy(replace(alone, taps={"nearest-centre": told}))

    failed = told(failed="step 21: ValueError: no idea")
    assert (failed.left, failed.why, failed.failed) == (None, "Eve failed", ("nearest-centre",))
    assert failed.exceeds, "what she had shown before she failed stays shown"
    silent = replace(alone.taps["nearest-centre"], pairs={})
    assert secrecy(replace(state, taps={"nearest-centre": silent})).why == "no guess yet"
    assert secrecy(replace(state, taps={})).why == "no tap"

    def blind(**changes: object) -> SecrecyScore:
        """One whose guesses alone leave all."""
        tap = state.taps["set-membership"]
        told = replace(tap, status=changed(tap.status, belief=changes))
        return secrecy(replace(alone, taps={"set-membership": told}))

    own = blind(bits_left=2.5, solved_k=12, given="English sentences")
    assert state.plant is not None
    all_there_are = state.plant.step.agreements * math.log2(state.candidates)
    assert own.left == stated_left(2.5, all_there_are)
    assert own.left is not None
    by_keys = f"by keys alone {all_there_are:.0f}"
    assert own.why == f"at most {own.left.high:.0f} given English sentences, {by_keys}"
    unsure = blind(bits_left=11.551, solved_k=-1)  # what she can follow, of a message under way
    assert unsure.left == stated_left(11.551, unsure.claimed_bits)
    assert "by its own account" in unsure.why
    assert "no whole message" in unsure.why
    assert blind(bits_left=1651.9).left_bits == all_there_are
    keys_alone = told()
    # an account that leaves more than her keys show is no secret either
    assert told(belief={"bits_left": 1651.9}).left == keys_alone.left
    both = replace(
        state,
        taps={
            "set-membership": state.taps["set-membership"],
            "nearest-centre": replace(
                alone.taps["nearest-centre"],
                status=alone.taps["nearest-centre"].status.model_copy(update={"failed": "x"}),
            ),
        },
    )
    assert secrecy(both).strongest == "set-membership"
    assert ranked(both)[-1][0].status.name == "nearest-centre"
    assert "FAILED" in secrecy_line(both)


def test_a_tap_that_holds_the_message_leaves_nothing_however_she_guesses_symbols() -> None:
    state = state_after(500)
    blind = replace(state, taps={"set-membership": state.taps["set-membership"]})
    told = with_tap(
        replace(blind, taps={**blind.taps, "list-decoder": state.taps["list-decoder"]}),
        "list-decoder",
        belief={"message": MESSAGE_TEXT},
        tail=(),
    )
    assert ranked(told)[0][0].status.name == "list-decoder"
    assert secrecy(told).left_bits == 0
    holds = replace(blind.taps["set-membership"], exact=True)
    assert secrecy(replace(state, taps={"set-membership": holds})).exceeds
    # Once broken it stays broken, also when she turns to the next message.
    moved_on = with_tap(told, "list-decoder", belief={"message": "..."}, seq=10**9)
    assert moved_on.taps["list-decoder"].exact


def test_a_tap_that_could_not_use_most_steps_keeps_no_secret_of_them() -> None:
    """One stray message deafened a tap, and "638 bits left" stood on the screen."""
    state = state_after(500)
    status = state.taps["nearest-centre"].status
    deaf = changed(status, unused={"foreign": 1600}, steps=200)
    one = replace(state.taps["nearest-centre"], status=deaf)
    its = secrecy(replace(state, taps={"nearest-centre": one}))
    assert its.silent_bits == round(0.8 * its.claimed_bits)
    assert its.left_bits is not None
    assert its.left_bits < 0.2 * its.claimed_bits
    assert "Eve could not use their steps" in its.why
    told = secrecy_line(replace(state, taps={"nearest-centre": one}))
    assert f"of {its.claimed_bits - its.silent_bits:.0f} bit (" in told
    # of one who heard all more is known, though she knows less
    both = {"nearest-centre": one, "set-membership": state.taps["set-membership"]}
    assert secrecy(replace(state, taps=both)).strongest == "nearest-centre"
    whole = {"nearest-centre": one, "list-decoder": state.taps["list-decoder"]}
    assert secrecy(replace(state, taps=whole)).strongest == "list-decoder"
    stray = changed(status, unused={"foreign": 1})
    heard = replace(one, status=stray)
    assert secrecy(replace(state, taps={"nearest-centre": heard})).silent_bits == 0


def test_text_is_judged_against_the_true_message_it_fits_best() -> None:
    state = with_plant(state_after(2000), secrets={"last_message": "Second message"})
    assert truth_for(state, "Secord mess") == "Second message"
    after = with_tap(state, "list-decoder", belief={"message": "Secord mess"})
    assert characters_right(after, after.taps["list-decoder"]) == (10, 14)
    assert truth_for(state, "") == MESSAGE_TEXT


def test_whether_a_tap_was_heard_before_she_was_sure_is_remembered() -> None:
    assert state_after(2000).taps["list-decoder"].watched
    assert state_after(2000).taps["list-decoder"].status.belief.solved_k >= 0
    late = with_tap(state_after(2000), "late", belief={"solved_k": 9})
    assert not late.taps["late"].watched
    blind = reduce(LoopState(), Arrival(1, state_after(20).taps["list-decoder"].status))
    assert not blind.taps["list-decoder"].watched, "nobody knows the truth yet"


def test_the_tap_that_reads_the_text_ranks_before_one_that_only_guesses_keys() -> None:
    state = state_after(500)
    garbled = with_tap(state, "nearest-centre", belief={"message": "#" * 20})
    tail = (guess._replace(symbol=0) for guess in garbled.taps["list-decoder"].status.tail)
    half = with_tap(garbled, "list-decoder", tail=tuple(tail))
    assert [tap.status.name for tap, _ in ranked(half)] == [
        "list-decoder",
        "nearest-centre",
        "set-membership",
    ]


# --- the source --------------------------------------------------------------------------------


def test_the_bus_source_takes_statuses_of_its_loop_and_counts_malformed() -> None:
    heard: set[str] = set()

    def spy(key: str, payload: bytes) -> list[bytes]:
        heard.add(key)
        return [payload]

    management, adversary = MemoryHub(), MemoryHub(fault=spy)
    services, taps = MemoryBus(management), MemoryBus(adversary)
    source = BusSource(MemoryBus(management), MemoryBus(adversary), "loop")
    for batch in batches(100):
        for arrival in batch:
            message = arrival.message
            assert message is not None
            bus = taps if isinstance(message, TapStatus) else services
            bus.publisher(key_of(type(message), "loop")).put(message.wire())
            bus.publisher(key_of(type(message), "other")).put(message.wire())
    services.publisher(key_of(ControllerStatus, "loop")).put(b"\xff{malformed")
    taps.publisher(key_of(TapStatus, "loop")).put(b'{"v": 1}')
    arrivals = source.drain()
    sent = [arrival.message for batch in batches(100) for arrival in batch]
    assert [a.message for a in arrivals] == [*sent, None, None]
    assert reduce_all(LoopState(), arrivals).malformed == 2
    assert "2 payloads" in source.problems()[0]
    assert source.drain() == []
    taps_own = {key_of(TapStatus, loop) for loop in ("loop", "other")}
    assert heard == taps_own, "the dashboard publishes nothing, so no truth reaches a tap"


def test_what_is_not_read_in_time_is_dropped_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_module, "WAITING_AT_MOST", 4096 * (1 + OVERHEAD))
    hub = MemoryHub()
    source = BusSource(MemoryBus(hub), MemoryBus(MemoryHub()), "loop")
    put = MemoryBus(hub).publisher(key_of(PlantStatus, "loop")).put
    for _ in range(5000):
        put(b"x")
    assert len(source.drain()) == 4096
    assert any("904 messages came faster" in line for line in source.problems())
