"""The relay of the campaigns, and the endurance run's judgement."""

import time
from typing import Any

import pytest

from protocol.messages import Measurement, Offer
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import free_endpoints
from runtime.zenoh_bus import ZenohBus
from tests.campaigns.endurance import judged
from tests.campaigns.relay import Relay


@pytest.mark.integration
@pytest.mark.parametrize(("loss", "repeat", "copies"), [(0.0, 1.0, 2), (1.0, 0.0, 0)])
def test_the_relay_passes_on_what_it_does_not_lose(loss: float, repeat: float, copies: int) -> None:
    plant_end, controller_end = free_endpoints(2)
    heard: list[bytes] = []
    back: list[bytes] = []
    with ZenohBus(listen=[plant_end]) as plant, ZenohBus(listen=[controller_end]) as controller:
        controller.subscribe(
            key_of(Measurement, DEFAULT_LOOP), lambda _k, body, _t: heard.append(body)
        )
        plant.subscribe(key_of(Offer, DEFAULT_LOOP), lambda _k, body, _t: back.append(body))
        relay = Relay(plant_end, controller_end, loss, repeat, 0.002, seed=1)
        publisher = plant.publisher(key_of(Measurement, DEFAULT_LOOP))
        until = time.monotonic() + 10
        while not publisher.matched:
            assert time.monotonic() < until
            time.sleep(0.02)
        while relay.counts["passed"] + relay.counts["lost"] < 20:
            publisher.put(b"x")
            assert time.monotonic() < until, relay.counts
            time.sleep(0.01)
        while len(heard) < copies * relay.counts["passed"]:
            assert time.monotonic() < until, relay.counts
            time.sleep(0.01)
        relay.close()
    assert len(heard) == copies * relay.counts["passed"]
    assert relay.counts["repeated"] == relay.counts["passed"]
    assert not back


@pytest.mark.parametrize(
    ("mib", "pads", "held", "wrong"),
    [
        (lambda i: 60.0 + min(i, 20), 3, 0, []),
        (lambda i: 60.0 + i, 3, 0, ["plant grew from 84.5 to 104.5 MiB"]),
        (lambda i: 60.0, 0, 0, ["the ledger was empty"]),
        (lambda i: 60.0, 3, 256, ["she holds 256 bits"]),
    ],
)
def test_growth_an_empty_ledger_and_held_bits_are_told(
    mib: Any, pads: int, held: int, wrong: list[str]
) -> None:
    looks = [{"s": i, "k": 100 * i, "pads": pads, "mib": {"plant": mib(i)}} for i in range(50)]
    keys = {
        "made": 9, "blocks": 2, "held_by_tap_bits": held, "missed_by_tap": 0.3,
        "same_at_both_ends": True, "last_block_bits_per_second": 840.0,
    }  # fmt: skip
    found = judged(looks, {"keys": keys})
    assert found["wrong"] == wrong
    assert found["steps_per_second_early_and_late"] == [100, 100]
