"""Asks and answers about keys on a thread of its own: it never holds the control loop up."""

import logging
import queue
import threading
import time
from functools import partial
from typing import Final, Self

from protocol.link.peer import Notice
from protocol.messages import Message
from protocol.secret.records import StoreError
from protocol.topics import key_of
from runtime.bus import Bus, TransportError
from runtime.inbox import Inbox
from runtime.keys.asking import Asker
from runtime.keys.store import KeyStore
from runtime.ports import BusPorts

POLL_S: Final = 0.2


class KeyThread:
    """An end's asker beside the loop, from entering to leaving the context.

    Parameters
    ----------
    store : KeyStore
        Its own opening of the file; closed at the end.
    loop : str
    management : Bus
        Open until after the end.
    log : logging.Logger
    """

    def __init__(self, store: KeyStore, loop: str, management: Bus, log: logging.Logger) -> None:
        self._store = store
        self._asker = Asker(store)
        self._inbox: Inbox[tuple[type[Message], bytes] | None] = Inbox()
        self._stopping = threading.Event()
        publishers = {kind: management.publisher(key_of(kind, loop)) for kind in Asker.says}
        self._ports = BusPorts(publishers, log)
        for kind in Asker.hears:
            management.subscribe(key_of(kind, loop), partial(self._arrived, kind))
        self._thread = threading.Thread(target=self._run, name="keys", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._inbox.put(None, None)
        self._thread.join()
        self._store.close()

    def _arrived(self, kind: type[Message], _key: str, payload: bytes, _t_ns: int) -> None:
        self._inbox.put((kind, payload), len(payload))

    def _run(self) -> None:
        while not self._stopping.is_set():
            wait_s = max(0.0, min(self._asker.wake_at() - time.monotonic(), POLL_S))
            try:
                item = self._inbox.get(timeout=wait_s)
            except queue.Empty:
                item = None
            try:
                self._turn(item)
            except (StoreError, TransportError) as error:  # a full disk: it may be better next time
                self._complain(str(error))
            except Exception as error:  # a fault: told, and no reason to answer nothing any more
                self._complain(f"unexpected {type(error).__name__}: {' '.join(str(error).split())}")
            self._ports.report_held_back()
        self._ports.report_held_back(last=True)

    def _turn(self, item: tuple[type[Message], bytes] | None) -> None:
        if item is not None:
            actions = self._asker.receive(*item)
            for message in actions.publish:
                self._ports.publish(message)
            for notice in actions.notices:
                self._ports.log_notice(notice)
        for request in self._asker.wake(time.monotonic()):
            self._ports.publish(request)

    def _complain(self, text: str) -> None:
        self._ports.log_notice(Notice(f"keys: {text}", "warning", "keys"))
