"""Runs an end of sealed messages on a thread of its own: it never holds the control loop up."""

import logging
import queue
import threading
import time
from functools import partial
from typing import Final, Self

from protocol.link.peer import Actions
from protocol.messages import FIELD, Message
from protocol.secret.records import StoreError
from protocol.topics import key_of
from runtime.bus import Bus, TransportError
from runtime.inbox import Inbox
from runtime.keys.sealing import End
from runtime.keys.store import KeyStore
from runtime.logs import RateLimitedLog

LOOK_S: Final = 0.2


class SealedThread:
    """One end beside the loop, from entering to leaving the context.

    Parameters
    ----------
    end : End
    store : KeyStore
        Its own opening of the file; closed at the end.
    loop : str
    field, ops : Bus
        Open until after the end.
    log : logging.Logger
    """

    def __init__(
        self, end: End, store: KeyStore, loop: str, field: Bus, ops: Bus, log: logging.Logger
    ) -> None:
        self._end, self._store, self._log = end, store, log
        self._complaints = RateLimitedLog(log)
        self._inbox: Inbox[tuple[type[Message], bytes] | None] = Inbox()
        self._stopping = threading.Event()
        buses = {kind: field if kind in FIELD else ops for kind in (*end.says, *end.hears)}
        self._publishers = {k: buses[k].publisher(key_of(k, loop)) for k in end.says}
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
            wait_s = max(0.0, min(self._end.wake_at() - time.monotonic(), LOOK_S))
            try:
                item = self._inbox.get(timeout=wait_s)
            except queue.Empty:
                item = None
            try:
                now = time.monotonic()
                if item is not None:
                    self._perform(self._end.receive(*item, now))
                if self._end.wake_at() <= now:
                    self._perform(self._end.wake(now))
            except (StoreError, TransportError) as error:  # a full disk: it may be better next time
                self._complaints.add(f"sealed messages: {error}")
            except Exception as error:  # a fault: told, and no reason to seal nothing any more
                what = f"unexpected {type(error).__name__}: {error}"
                self._complaints.add(f"sealed messages: {' '.join(what.split())}")
            self._complaints.tell_rest()
        self._complaints.tell_rest(last=True)

    def _perform(self, actions: Actions) -> None:
        """What is to be saved was saved by the end itself, in its store."""
        for kind, payload in actions.publish:
            self._publishers[kind].put(payload)
        for notice in actions.notices:
            if notice.subject:
                self._complaints.add(notice.text)
            else:
                self._log.info("%s", notice.text)
