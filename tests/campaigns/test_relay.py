"""The relay of the campaigns."""

import time

import pytest

from protocol.messages import Measurement, Offer
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import free_endpoints
from runtime.zenoh_bus import ZenohBus
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
