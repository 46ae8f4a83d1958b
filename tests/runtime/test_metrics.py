"""Metrics: what Prometheus is told is what the newest statuses say."""

import logging
import threading
import urllib.request
from pathlib import Path
from typing import NoReturn

import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.service import ControllerConfig, open_controller
from plant_service.service import PlantConfig, open_plant
from protocol.messages import ControllerStatus, PlantStatus, TapStatus
from protocol.messages.adversary import KeysHeld
from protocol.scenario import Scenario
from protocol.topics import key_of
from runtime.errors import UsageError
from runtime.host import Host
from runtime.metrics import NotedBus, Statuses, served
from runtime.pace import Pace
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.statuses import changed, status_of

pytest.importorskip("prometheus_client")


def read(port: int) -> dict[str, float]:
    """The samples at a port, by their line's first word."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=PATIENCE_S) as answer:
        lines = answer.read().decode().splitlines()
    samples = (line.rpartition(" ") for line in lines if not line.startswith("#"))
    return {name: float(value) for name, _, value in samples}


def test_every_loop_is_told_of_by_its_newest_status(
    sustained: Scenario, sustained_law: CandidateLaw, tmp_path: Path
) -> None:
    statuses: Statuses = {}
    bus = NotedBus(MemoryBus(MemoryHub()), statuses)
    for loop in ("a", "b"):
        plant, files = open_plant(
            PlantConfig(sustained, tmp_path / loop, loop, Pace("realtime")), 0.0
        )
        files.close()
        stopped = "no pad is left" if loop == "b" else ""
        status = changed(
            status_of(plant, 0.0),
            step={"k": 70, "missed": 3},
            timing={"latency_counts": (5, 2, *[0] * 17, 1)},
            keys={"made": 63, "stopped": stopped, "lost": 2, "digits_left": 128},
        )
        put = bus.publisher(key_of(PlantStatus, loop)).put
        put(changed(status, step={"k": 1}).wire())
        put(status.wire())
    config = ControllerConfig(sustained, tmp_path / "a", "a", law=sustained_law)
    controller, files = open_controller(config)
    files.close()
    told = changed(status_of(controller), frame={"delivered": 2})
    bus.publisher(key_of(ControllerStatus, "a")).put(told.wire())
    tap = TapStatus(name="nearest-centre", steps=9, lost=2, mirrored=20)
    counts = {"blocks": 1, "broken": 1, "bits": 256, "copies": 90, "missed": 3}
    keys = KeysHeld(**counts, at_most=0.1, refuted=True, bursts=False)
    for hers in (tap, tap.model_copy(update={"name": "key-solver", "keys": keys})):
        bus.publisher(key_of(TapStatus, "a")).put(hers.wire())
    with served("127.0.0.1:0", statuses) as port:
        samples = read(port)
    of = '{eavesdropper="",loop="%s",service="plant"}'
    for loop in ("a", "b"):
        assert samples["wyner_steps_total" + of % loop] == 70
        assert samples["wyner_missed_steps_total" + of % loop] == 3
        its = f'eavesdropper="",le="%s",loop="{loop}",service="plant"'
        bucket = "wyner_offer_latency_seconds_bucket{" + its + "}"
        assert samples[bucket % "0.0005"] == 5
        assert samples[bucket % "0.001"] == 7
        assert samples[bucket % "+Inf"] == 8
    delivered = 'wyner_messages_delivered_total{eavesdropper="",loop="a",service="controller"}'
    assert samples[delivered] == 2
    for loop in ("a", "b"):
        assert samples["wyner_keys_made_total" + of % loop] == 63
        assert samples["wyner_keys_stopped" + of % loop] == (loop == "b")
        assert samples["wyner_keys_blocks_lost_total" + of % loop] == 2
        assert samples["wyner_keys_digits_left" + of % loop] == 128
    of_hers = '{eavesdropper="key-solver",loop="a",service="tap"}'
    assert samples["wyner_keys_bits_held_total" + of_hers] == 256
    assert samples["wyner_keys_copies_missed_total" + of_hers] == 3
    assert samples["wyner_keys_claim_refuted" + of_hers] == 1
    other = '{eavesdropper="nearest-centre",loop="a",service="tap"}'
    assert samples["wyner_tap_lost_total" + other] == 2
    assert "wyner_keys_bits_held_total" + other not in samples, "it goes for no keys"


@pytest.mark.parametrize("address", ["", "9100", "127.0.0.1:x", "127.0.0.1:²", "127.0.0.1:70000"])
def test_an_address_that_is_none_is_told(address: str) -> None:
    with pytest.raises(UsageError, match="expected HOST:PORT"), served(address, {}):
        pass


def test_nothing_is_told_of_a_loop_that_has_left(
    sustained: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last figures stood there for ever, as if it were still running."""

    def fails(_now: float) -> NoReturn:
        raise ArithmeticError("an odd set")

    statuses: Statuses = {}
    management = NotedBus(MemoryBus(MemoryHub()), statuses)
    stopping = threading.Event()
    host = Host(MemoryBus(MemoryHub()), management, stopping, fleet=True)
    for loop in ("a", "b"):
        config = PlantConfig(sustained, tmp_path / loop, loop, Pace("realtime"))
        core, files = open_plant(config, 0.0)
        management.publisher(key_of(PlantStatus, loop)).put(status_of(core, 0.0).wire())
        if loop == "a":
            monkeypatch.setattr(core, "start", fails)
        host.add(loop, core, files, logging.getLogger("metrics"))
    assert {loop for _, loop, _ in statuses} == {"a", "b"}
    thread = threading.Thread(target=host.run)
    thread.start()
    try:
        wait_for(lambda: {loop for _, loop, _ in statuses} == {"b"})
    finally:
        stopping.set()
        thread.join(PATIENCE_S)
    assert statuses == {}
