"""What one end gives is marked at the other first, so that a store put back gives nothing twice.

A key store that is put back from a copy cannot know what it gave since. Its partner can. So a key
is given in three steps: it is set aside here for one *use*, a name that is drawn for it; the
partner marks it with that use, on its disk; and only then is it taken. A partner that has marked a
key for another use refuses, and so does one that does not have it. Whatever end is put back, and
whenever, the other one knows; where both are put back together nobody does.

Giving anew under a use that was granted is harmless where the use says all of what is done: a
sealed message's text stands beside its use, so the same bytes come of it. A key server forgets the
uses of its former lives.

The pads that sign a session's first key block are agreed on alike: the use is the session.
"""

import json
import secrets
import time
from collections.abc import Callable, Sequence
from typing import Final, Literal, NamedTuple

from protocol.secret.records import WHOLE, Key, Share, UnknownKeys
from runtime.keys.store import KeyStore

ANSWER_S: Final = 2.0
"""How long a key server waits for the partner's word, while its caller waits."""

LOOK_S: Final = 0.005

SERVED: Final = "served"
SEALED: Final = "sealed"
"""What a use begins with: a key server's caller, or a sealed message, whose identifier follows."""

What = Literal["keys", "pads", "unused", "made", "marked", "ready", "blocks", "lacked"]


class Unanswered(Exception):
    """The partner has not marked the keys yet; what was set aside waits for it."""

    def __init__(self) -> None:
        super().__init__(
            "the other end has not agreed yet: keys are given while both ends' services run"
        )


class Asking(NamedTuple):
    """What this end wants the other to mark, and for which use."""

    use: str
    what: What
    names: tuple[str, ...]


def new_use(kind: str, name: str = "") -> str:
    """A use that was never named before."""
    return " ".join(filter(None, (kind, name, secrets.token_hex(8))))


def pending(store: KeyStore, most: int = 8) -> list[Asking]:
    """What the partner has not answered, oldest first."""
    rows = store.rows(
        "SELECT use, what, names FROM asked WHERE refused IS NULL ORDER BY rowid LIMIT ?", (most,)
    )
    return [Asking(use, what, tuple(json.loads(names))) for use, what, names in rows]


class Giver:
    """Gives keys of a store to callers, one process's life long.

    Parameters
    ----------
    store : KeyStore
    wait_s : float
        How long to wait for the partner's word.
    look : callable
        Called again and again meanwhile.
    """

    def __init__(
        self,
        store: KeyStore,
        wait_s: float = ANSWER_S,
        look: Callable[[], None] = lambda: time.sleep(LOOK_S),
    ) -> None:
        self._store = store
        self._wait_s = wait_s
        self._look = look
        self._waiting: dict[object, str] = {}
        store.forget_uses(SERVED)

    def deliver(self, number: int = 1, who: str = "", share: Share = WHOLE) -> tuple[Key, ...]:
        """The oldest confirmed keys of this side's half; all or none, each once.

        Keys that the partner refuses are erased, and others take their place.

        Raises
        ------
        TooFewKeys, KeysRefused, StoreError
        Unanswered
            When the partner did not answer in time. Who asks for as many later gets these.
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
        """Keys of the partner's half by their ids, which the partner has given; all or none.

        Raises
        ------
        OthersKeys
            When some are of another share.
        UnknownKeys
            When some are not here, were delivered before, or were not given by the partner.
        KeysRefused, StoreError, Unanswered
            As :meth:`deliver`.
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
        """The names that the partner refuses."""
        until = time.monotonic() + self._wait_s
        while (refused := self._store.answer(use)) is None:
            if time.monotonic() >= until:
                raise Unanswered
            self._look()
        return refused
