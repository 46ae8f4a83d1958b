"""The thread that asks and answers about keys: a fault there is told, and nothing dies of it."""

import logging
import threading
from pathlib import Path

import pytest
from runtime.key_thread import KeyThread
from runtime.keys.asking import Asker
from runtime.keys.store import KeyStore

from protocol.link.peer import Actions
from protocol.messages import KeyRequest, Message
from protocol.topics import key_of
from runtime.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S


def test_a_fault_is_told_in_a_line_and_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[bytes] = []
    again = threading.Event()

    def receive(_asker: Asker, _kind: type[Message], payload: bytes) -> Actions:
        heard.append(payload)
        if len(heard) == 1:
            raise KeyError("nobody\n thought of this")
        again.set()
        return Actions()

    monkeypatch.setattr(Asker, "receive", receive)
    hub = MemoryHub()
    store = KeyStore(tmp_path / "keys.sqlite3", "controller", create=True)
    with (
        caplog.at_level(logging.WARNING),
        KeyThread(store, "one", MemoryBus(hub), logging.getLogger("x")),
    ):
        publisher = MemoryBus(hub).publisher(key_of(KeyRequest, "one"))
        publisher.put(b"first")
        publisher.put(b"second")
        assert again.wait(PATIENCE_S)
    assert heard == [b"first", b"second"]
    (record,) = caplog.records
    assert record.getMessage().startswith("keys: unexpected KeyError: ")
    assert "\n" not in record.getMessage()
