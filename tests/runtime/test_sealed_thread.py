"""Sealed messages beside the loop: whatever goes wrong there is told, and nothing dies of it."""

import logging
import threading
import time
from pathlib import Path

import pytest

from protocol.link.peer import NOTHING_TO_DO, Actions
from protocol.messages import Message, SealedReceipt
from protocol.topics import key_of
from runtime.keys.store import KeyStore
from runtime.memory_bus import MemoryBus, MemoryHub
from runtime.sealed_thread import SealedThread
from tests.support.patience import PATIENCE_S


class Faulty:
    """An end that stumbles over the first message, and takes the second."""

    hears: tuple[type[Message], ...] = (SealedReceipt,)
    says: tuple[type[Message], ...] = ()

    def __init__(self) -> None:
        self.heard: list[bytes] = []
        self.again = threading.Event()

    def wake_at(self) -> float:
        return time.monotonic() + 60

    def wake(self, now: float) -> Actions:
        return NOTHING_TO_DO

    def finish_step(self) -> Actions:
        return NOTHING_TO_DO

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        self.heard.append(payload)
        if len(self.heard) == 1:
            raise KeyError("nobody\n thought of this")
        self.again.set()
        return NOTHING_TO_DO


def test_a_fault_is_told_in_a_line_and_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    hub, end = MemoryHub(), Faulty()
    store = KeyStore(tmp_path / "keys.sqlite3", "controller", create=True)
    buses = MemoryBus(MemoryHub()), MemoryBus(hub)
    with (
        caplog.at_level(logging.WARNING),
        SealedThread(end, store, "one", *buses, logging.getLogger("x")),
    ):
        publisher = MemoryBus(hub).publisher(key_of(SealedReceipt, "one"))
        publisher.put(b"first")
        publisher.put(b"second")
        assert end.again.wait(PATIENCE_S)
    assert end.heard == [b"first", b"second"]
    (record,) = caplog.records
    assert record.getMessage().startswith("sealed messages: unexpected KeyError: ")
    assert "\n" not in record.getMessage()
