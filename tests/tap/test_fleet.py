"""The taps of a fleet: one subscription, a recording for each loop."""

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import tap_service.service
from protocol.messages import Measurement, Offer, TapStatus
from protocol.scenario import Scenario
from protocol.topics import key_of
from runtime.errors import UsageError
from runtime.fleet import FleetLoop, read_fleet
from runtime.run_folder import CAPTURE
from tap_service.config import TapConfig
from tap_service.fleet import TapFleet
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.told import log_of


def captured(folder: Path, loop: str) -> list[tuple[str, int]]:
    """Topic and step of each message in one loop's recording."""
    lines = (folder / loop / CAPTURE).read_bytes().splitlines()
    events = [json.loads(line) for line in lines]
    return [(e["topic"], e["message"]["k"]) for e in events if e["event"] == "field"]


@pytest.fixture
def config_of(sustained: Scenario, tmp_path: Path) -> Callable[[FleetLoop], TapConfig]:
    def config_of(loop: FleetLoop) -> TapConfig:
        if loop.id == "bad":
            raise UsageError("nothing is known of this one")
        return TapConfig(
            run_dir=tmp_path / loop.id,
            knowledge=sustained.knowledge().model_copy(update={"alpha": None}),
            names=("set-membership",),
            loop=loop.id,
        )

    return config_of


def test_each_loop_is_recorded_in_its_own_folder(
    config_of: Callable[[FleetLoop], TapConfig], sustained: Scenario, tmp_path: Path
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text('[[loop]]\nid = "a"\n[[loop]]\nid = "b"\n[[loop]]\nid = "bad"\n')
    field, adversary = MemoryHub(), MemoryHub()
    statuses: dict[str, TapStatus] = {}
    MemoryBus(adversary).subscribe(
        "**",
        lambda key, payload, _t: statuses.update(
            {key.split("/")[2]: TapStatus.model_validate_json(payload)}
        ),
    )
    taps = TapFleet(read_fleet(path), config_of)
    taps.attach(MemoryBus(field), MemoryBus(adversary))
    stopping = threading.Event()
    thread = threading.Thread(target=taps.run, args=(stopping,))
    thread.start()
    source = MemoryBus(field)
    put = {
        (kind, loop): source.publisher(key_of(kind, loop)).put
        for kind in (Measurement, Offer)
        for loop in ("a", "b", "bad", "unknown")
    }
    n = sustained.n
    for loop in ("a", "b", "bad", "unknown"):
        for k in range(3 if loop == "a" else 5):
            after = (0.0,) * n if k else ()
            measurement = Measurement(
                session="1" * 16, k=k, x=(0.0,) * n, applied_k=k - 1, x_after=after
            )
            put[Measurement, loop](measurement.wire())
            offer = Offer(session="1" * 16, k=k, candidates=((0.0,), (1.0,)), cipher=0)
            put[Offer, loop](offer.wire())
    wait_for(lambda: statuses.keys() == {"a", "b"} and statuses["b"].mirrored == 10)
    wait_for(lambda: statuses["a"].mirrored == 6)
    stopping.set()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert captured(tmp_path, "a") == [(t, k) for k in range(3) for t in ("measurement", "offer")]
    assert len(captured(tmp_path, "b")) == 10
    assert not (tmp_path / "bad").exists()
    assert not (tmp_path / "unknown").exists()
    assert statuses["b"].unused.dropped == 0


def test_the_taps_of_a_fleet_share_the_bytes_that_may_wait(
    config_of: Callable[[FleetLoop], TapConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flood on one loop takes that loop's share, and what another's tap has waiting stays."""
    monkeypatch.setattr(tap_service.service, "QUEUE_BYTES", 100_000)
    path = tmp_path / "fleet.toml"
    path.write_text("".join(f'[[loop]]\nid = "{name}"\n' for name in "abcd"))
    field = MemoryHub()
    taps = TapFleet(read_fleet(path), config_of)
    taps.attach(MemoryBus(field), MemoryBus(MemoryHub()))
    put = {name: MemoryBus(field).publisher(key_of(Offer, name)).put for name in "ab"}
    body = bytes(300)  # and OVERHEAD for each: 50 have room
    put["b"](body)
    for _ in range(1000):
        put["a"](body)
    a, b = (taps.taps[name].queue for name in "ab")
    assert (len(a), a.dropped) == (50, 950)
    assert (len(b), b.dropped) == (1, 0)
    taps.close()


def test_a_loop_whose_tap_cannot_be_made_or_fails_ends_no_others(
    config_of: Callable[[FleetLoop], TapConfig],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One goes for keys where none are made, another raises: the third ends with its marks."""
    path = tmp_path / "fleet.toml"
    path.write_text("".join(f'[[loop]]\nid = "{name}"\n' for name in ("keyless", "raises", "good")))

    def with_key_solver(loop: FleetLoop) -> TapConfig:
        config = config_of(loop)
        return replace(config, names=("key-solver",)) if loop.id == "keyless" else config

    taps = TapFleet(read_fleet(path), with_key_solver)
    with log_of("tap") as knowledge_of:
        taps.attach(MemoryBus(MemoryHub()), MemoryBus(MemoryHub()))

        def breaks() -> None:
            raise RuntimeError("on purpose")

        monkeypatch.setattr(taps.taps["raises"], "publish", breaks)
        stopping = threading.Event()
        thread = threading.Thread(target=taps.run, args=(stopping,))
        thread.start()
        wait_for(lambda: "raises" not in taps.taps)
        assert "good" in taps.taps
        stopping.set()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert any(x.startswith("loop keyless: not listened to: ") for x in knowledge_of)
    assert "loop raises: its tap failed: RuntimeError: on purpose" in knowledge_of
    for name in ("raises", "good"):
        last = (tmp_path / name / CAPTURE).read_bytes().splitlines()[-1]
        assert json.loads(last)["event"] == "end"
