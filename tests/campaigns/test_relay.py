"""The relay of the campaigns."""

import time

import pytest

from protocol.messages import Measurement, Offer
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import free_endpoints
from runtime.zenoh_bus import ZenohBus
from tests.campaigns.relay import Relay
from tests.support.patience import wait_for

SENT = 20


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
        wait_for(lambda: publisher.matched)
        while copies and not heard:  # the way on is there when something has come over it
            publisher.put(b"first")
            time.sleep(0.02)
        for _ in range(SENT):
            publisher.put(b"x")
            time.sleep(0.01)
        if copies:
            wait_for(lambda: heard.count(b"x") >= copies * SENT)
        wait_for(lambda: relay.counts["passed"] + relay.counts["lost"] >= SENT)
        relay.close()
    assert heard.count(b"x") == copies * SENT
    assert relay.counts["repeated"] == relay.counts["passed"]
    assert not back
