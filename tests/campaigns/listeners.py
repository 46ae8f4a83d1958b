"""Who hears a bus beside the two ends: tap, dashboard, the run's own watcher, sealed messages."""

from pathlib import Path
from typing import Protocol

from protocol.messages import (
    ControllerStatus,
    KeyAnswer,
    KeyRequest,
    Measurement,
    Message,
    Offer,
    PlantModel,
    PlantStatus,
    SealCommand,
    Sealed,
    SealedReceipt,
    TapStatus,
)
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import Addresses
from runtime.bus import Deliver
from runtime.keys.sealed_book import SealedBook
from runtime.keys.sealing import OpeningEnd, SealingEnd
from runtime.keys.store import KeyStore
from runtime.memory_bus import MemoryBus, MemoryHub
from tap_service.capture.recording import Limits
from tap_service.config import TapConfig
from tap_service.service import TapService
from tests.support.small_run import law_of
from tools.rehearsal import Rehearsal
from wyner.dashboard.app import Watch
from wyner.dashboard.headless import Reporter
from wyner.dashboard.screenshot import to_text
from wyner.dashboard.source import BusSource

LISTENERS = ("tap", "dashboard", "watcher", "sealing")

AT_ONCE = 100
"""Messages that wait before a listener looks at them."""

MOST_BYTES = 2**24
"""Of a tap's capture."""


class Listener(Protocol):
    """Hears messages of some kinds; ``goes_on`` fails where it does not any more."""

    kinds: tuple[type[Message], ...]

    def hear(self, kind: type[Message], payload: bytes) -> None:
        """A message came."""

    def goes_on(self) -> None:
        """It still does what it is there for."""

    def close(self) -> None:
        """The campaign is over."""


class Tap:
    """The tap's service with two light eavesdroppers, on buses of this process."""

    kinds: tuple[type[Message], ...] = (Measurement, Offer, Sealed)

    def __init__(self, folder: Path, heard: list[bytes]) -> None:
        limits = Limits(part_bytes=2**20, total_bytes=MOST_BYTES, free_bytes=0)
        config = TapConfig(
            folder,
            law_of("sustained")[0].knowledge(),
            Addresses(),
            Addresses(),
            names=("set-membership", "nearest-centre"),
            limits=limits,
        )
        self.service = TapService(config)
        self.service.publish_on(MemoryBus(MemoryHub()))
        self._folder, self._good, self._waiting, self._t_ns = folder, heard[:2], 0, 1

    def hear(self, kind: type[Message], payload: bytes) -> None:
        """As from the transport's thread."""
        self._t_ns += 1
        self.service.deliver(key_of(kind, DEFAULT_LOOP), payload, self._t_ns)
        self._waiting += 1
        if self._waiting >= AT_ONCE:
            self._look()

    def _look(self) -> None:
        self._waiting = 0
        while self.service.queue:
            self.service.work(0.0)

    def goes_on(self) -> None:
        """What is heard is written down, within its bound, and statuses are published."""
        self._look()
        before = self.service.capture.written
        for payload in self._good:
            self.hear(Measurement if b'"x"' in payload else Offer, payload)
        self._look()
        assert self.service.capture.written >= before + 2
        self.service.publish()
        self.service.write_beliefs()
        size = sum(path.stat().st_size for path in (self._folder / "tap").glob("*.jsonl"))
        assert size <= MOST_BYTES * 1.3

    def close(self) -> None:
        """End the recordings."""
        self.service.finish()
        self.service.close()


class Dashboard:
    """The screen and the lines without one, from statuses on the buses."""

    kinds: tuple[type[Message], ...] = (PlantModel, PlantStatus, ControllerStatus, TapStatus)

    def __init__(self, folder: Path) -> None:
        hub = MemoryHub()
        bus = MemoryBus(hub)
        self._source = BusSource(MemoryBus(hub), MemoryBus(hub), DEFAULT_LOOP)
        self._publishers = {kind: bus.publisher(key_of(kind, DEFAULT_LOOP)) for kind in self.kinds}
        self._watch = Watch(unicode=True, folder=folder)
        self._reporter = Reporter()
        self._waiting = self._looks = 0

    def hear(self, kind: type[Message], payload: bytes) -> None:
        """As from the bus."""
        self._publishers[kind].put(payload)
        self._waiting += 1
        if self._waiting >= AT_ONCE:
            self.goes_on()

    def goes_on(self) -> None:
        """It draws, and says nothing that a terminal would obey."""
        self._waiting = 0
        self._looks += 1
        self._watch.take(self._source)
        lines, self._reporter = self._reporter.report(self._watch.state, self._looks * 10**9)
        if self._looks % 10 == 0:
            size = ((80, 24), (200, 60), (40, 10))[self._looks % 3]
            lines += to_text(self._watch.draw(size, 0), size).splitlines()
        assert all(line.isprintable() for line in lines), lines

    def close(self) -> None:
        """Nothing is left open."""


class Watcher:
    """What `wyner up` hears of its own services, to know when the run is over."""

    kinds: tuple[type[Message], ...] = (PlantStatus, ControllerStatus)

    def __init__(self) -> None:
        from wyner.cli.up import Progress

        class Nobody:
            def poll(self) -> None:
                """No child."""

        progress = Progress(until_delivered=True, supervisor=Nobody())  # type: ignore[arg-type]
        self._hear: dict[type[Message], Deliver] = {
            PlantStatus: progress.plant_said,
            ControllerStatus: progress.controller_said,
        }

    def hear(self, kind: type[Message], payload: bytes) -> None:
        """As from the transport's thread."""
        self._hear[kind]("", payload, 0)

    def goes_on(self) -> None:
        """It has raised nothing."""

    def close(self) -> None:
        """Nothing is left open."""


class Sealing:
    """Both ends of sealed messages, beside their stores."""

    kinds: tuple[type[Message], ...] = (
        SealCommand,
        SealedReceipt,
        Sealed,
        KeyRequest,
        KeyAnswer,
    )

    def __init__(self, folder: Path) -> None:
        self._stores = [
            KeyStore(folder / f"{side}.sqlite3", side, create=True)
            for side in ("controller", "plant")
        ]
        self._sealing = SealingEnd(SealedBook(self._stores[0]), 0.0)
        self._opening = OpeningEnd(SealedBook(self._stores[1]))
        self._now = 0.0

    def hear(self, kind: type[Message], payload: bytes) -> None:
        """By whoever hears that kind."""
        self._now += 0.01
        for end in (self._opening, self._sealing):
            if kind not in end.hears:
                continue
            for notice in end.receive(kind, payload, self._now).notices:
                assert notice.subject, f"logged without a limit: {notice.text}"
            if end.wake_at() <= self._now:
                end.wake(self._now)

    def goes_on(self) -> None:
        """It has raised nothing."""

    def close(self) -> None:
        """Close both stores."""
        for store in self._stores:
            store.close()


def listener(name: str, folder: Path, field: list[bytes]) -> tuple[Listener, list[bytes]]:
    """A listener by name, and messages of its kinds to begin with.

    Parameters
    ----------
    name : str
        ``tap``, ``dashboard``, ``watcher`` or ``sealing``.
    folder : Path
    field : list of bytes
        A measurement and an offer that were heard, and more.
    """
    if name == "tap":
        return Tap(folder, field), field
    if name == "sealing":
        heard = [
            SealCommand(id="a", payload=b"x" * 9).wire(),
            SealedReceipt(id="a").wire(),
            KeyRequest(side="plant", use="served a", what="keys", names=("a",)).wire(),
            KeyAnswer(side="controller", use="sealed a b", what="keys", refused=()).wire(),
            Sealed(id="a", key_ids=("0" * 32,), cipher=b"x" * 9, tag="0" * 32).wire(),
        ]
        return Sealing(folder), heard
    statuses = [a.message for batch in Rehearsal().arrivals(300) for a in batch]
    kinds = Watcher.kinds if name == "watcher" else Dashboard.kinds
    heard = [status.wire() for status in statuses if isinstance(status, kinds)]
    return (Watcher() if name == "watcher" else Dashboard(folder)), heard
