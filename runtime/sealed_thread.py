"""Runs an end of sealed messages on a thread of its own: it never holds the control loop up."""

import logging
import queue
import threading
import time
from functools import partial
from typing import Final, Self

from protocol.link.events import Event
from protocol.link.peer import Actions, Notice
from protocol.messages import FIELD, Message, Status
from protocol.secret.records import StoreError
from protocol.secret.tasks import Task
from protocol.topics import key_of
from runtime.bus import Bus, TransportError
from runtime.inbox import Inbox
from runtime.keys.sealing import End
from runtime.keys.store import KeyStore
from runtime.perform import perform
from runtime.ports import BusPorts

POLL_S: Final = 0.2


class SealedThread:
    """One end beside the loop, from entering to leaving the context.

    Parameters
    ----------
    end : End
    store : KeyStore
        Its own opening of the file; closed at the end.
    loop : str
    field, management : Bus
        Open until after the end.
    log : logging.Logger
    """

    def __init__(
        self, end: End, store: KeyStore, loop: str, field: Bus, management: Bus, log: logging.Logger
    ) -> None:
        self._end, self._store = end, store
        self._inbox: Inbox[tuple[type[Message], bytes] | None] = Inbox()
        self._stopping = threading.Event()
        buses = {kind: field if kind in FIELD else management for kind in (*end.says, *end.hears)}
        self._ports = _Ports({k: buses[k].publisher(key_of(k, loop)) for k in end.says}, log)
        for kind in end.hears:
            buses[kind].subscribe(key_of(kind, loop), partial(self._arrived, kind))
        self._thread = threading.Thread(target=self._run, name="sealed", daemon=True)

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
            wait_s = max(0.0, min(self._end.wake_at() - time.monotonic(), POLL_S))
            try:
                item = self._inbox.get(timeout=wait_s)
            except queue.Empty:
                item = None
            try:
                now = time.monotonic()
                if item is not None:
                    perform(self._end.receive(*item, now), self._end, self._ports)
                if self._end.wake_at() <= now:
                    perform(self._end.wake(now), self._end, self._ports)
            except (StoreError, TransportError) as error:  # a full disk: it may be better next time
                self._complain(f"sealed messages: {error}")
            except Exception as error:  # a fault: told, and no reason to seal nothing any more
                what = f"unexpected {type(error).__name__}: {error}"
                self._complain(f"sealed messages: {' '.join(what.split())}")
            self._ports.report_held_back()
        self._ports.report_held_back(last=True)

    def _complain(self, text: str) -> None:
        self._ports.log_notice(Notice(text, "warning", "sealed messages"))


class _Ports(BusPorts):
    """What these ends say; what must be kept they keep themselves, in their store."""

    def save(self, actions: Actions) -> None:
        """There is no journal."""
        raise AssertionError(f"a sealed message's end has no journal for {actions}")

    def trace(self, event: Event) -> None:
        """There is no trace."""
        raise AssertionError(f"a sealed message's end has no trace for {event}")

    def submit_key_task(self, task: Task) -> None:
        """There is no key maker."""
        raise AssertionError(f"a sealed message's end has no key maker for {task}")

    def health(self, status: Status) -> None:
        """There is no status."""
        raise AssertionError(f"a sealed message's end has no status like {status}")
