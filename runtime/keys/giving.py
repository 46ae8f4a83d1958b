"""Keys are marked at the other end before they are given, so a store put back gives none twice.

A key store that is put back from a copy cannot know what it gave since. Its partner can. So a key
is given in three steps. It is set aside here for one *use*, a fresh name. The partner marks it with
that use, on its disk. Only then is it taken. A partner refuses a key that it has marked for another
use, or does not have. If one end is put back the other one knows; if both are put back at once
nobody does.

The pads that sign a session's first key block are marked alike. Their use is the session.
"""

import json
import secrets
import time
from collections.abc import Callable, Sequence
from typing import Final, Literal, NamedTuple

from protocol.secret.records import WHOLE, Key, Share, UnknownKeys
from runtime.keys.store import KeyStore

ANSWER_S: Final = 2.0
"""Seconds that a giver waits for the partner's answer."""

POLL_S: Final = 0.005
"""Seconds between two looks for that answer."""

SERVED: Final = "served"
"""First word of a use: a caller."""

What = Literal["keys", "pads", "unused", "made", "marked", "ready", "blocks", "lacked"]


class Unanswered(Exception):
    """The partner has not marked the keys yet. They stay set aside."""

    def __init__(self) -> None:
        super().__init__(
            "the other end has not agreed yet: keys are given while both ends' services run"
        )


class Asking(NamedTuple):
    """A request: what the other end is to mark or to say, and for which use."""

    use: str
    what: What
    names: tuple[str, ...]


def new_use(kind: str, name: str = "") -> str:
    """A fresh name of a use: kind, name, and 64 random bits."""
    return " ".join(filter(None, (kind, name, secrets.token_hex(8))))


def pending(store: KeyStore, most: int = 8) -> list[Asking]:
    """Requests that the partner has not answered, oldest first; ``most`` at most."""
    rows = store.rows(
        "SELECT use, what, names FROM asked WHERE refused IS NULL ORDER BY rowid LIMIT ?", (most,)
    )
    return [Asking(use, what, tuple(json.loads(names))) for use, what, names in rows]


class Giver:
    """Gives keys of a store to callers.

    Uses of former processes are forgotten, and their keys erased.

    Parameters
    ----------
    store : KeyStore
    wait_s : float
        Seconds to wait for the partner's answer.
    look : callable
        Called between two looks for it; sleeps.
    """

    def __init__(
        self,
        store: KeyStore,
        wait_s: float = ANSWER_S,
        look: Callable[[], None] = lambda: time.sleep(POLL_S),
    ) -> None:
        self._store = store
        self._wait_s = wait_s
        self._look = look
        self._waiting: dict[object, str] = {}
        store.forget_uses(SERVED)

    def deliver(self, number: int = 1, who: str = "", share: Share = WHOLE) -> tuple[Key, ...]:
        """The oldest confirmed keys of this side's half: ``number`` of them, or none.

        Keys that the partner refuses are erased, and others take their place.

        Raises
        ------
        TooFewKeys, KeysRefused, StoreError
        Unanswered
            When the partner did not answer in time. The next caller for as many gets these.
        """
        wanted = number, share
        while True:
            use = self._waiting.get(wanted)
            if use is None:
                use = self._waiting[wanted] = new_use(SERVED)
                try:
                    self._store.set_aside(use, number, share)
                except BaseException:
                    del self._waiting[wanted]
                    raise
            refused = self._answer(use)
            del self._waiting[wanted]
            if not refused:
                return self._store.take(use, who)

    def deliver_named(
        self, ids: Sequence[str], who: str = "", share: Share = WHOLE
    ) -> tuple[Key, ...]:
        """Keys of the partner's half by their ids, once the partner gave them: all or none.

        Raises
        ------
        OthersKeys
            When some are of another share.
        UnknownKeys
            When some are not here, were delivered before, or were not given by the partner.
        KeysRefused, StoreError, Unanswered
            As in :meth:`deliver`.
        """
        wanted = tuple(dict.fromkeys(ids)), share
        if not wanted[0]:
            self._store.check_refused()
            return ()
        use = self._waiting.get(wanted)
        if use is None:
            use = new_use(SERVED)
            self._store.set_aside_named(use, wanted[0], share)
            self._waiting[wanted] = use
        refused = self._answer(use)
        del self._waiting[wanted]
        if refused:
            raise UnknownKeys(refused)
        return self._store.take(use, who)

    def _answer(self, use: str) -> tuple[str, ...]:
        """The names that the partner refuses to mark."""
        until = time.monotonic() + self._wait_s
        while (refused := self._store.answer(use)) is None:
            if time.monotonic() >= until:
                raise Unanswered
            self._look()
        return refused
