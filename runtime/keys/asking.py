"""The part of either end that asks the other to mark what is about to be given, and answers.

Whoever gives keys writes the request into the key store. So this part looks there every `POLL_S`.

An end that starts also asks which of its keys and pads were given before, and erases them: its
store may have been put back from a copy.
"""

from collections.abc import Sequence
from math import inf
from typing import Final

from pydantic import ValidationError

from protocol.link.peer import Actions, Notice
from protocol.messages import KeyAnswer, KeyRequest, Message
from runtime.keys import ledger
from runtime.keys.giving import Asking, What, new_use, pending
from runtime.keys.store import KeyStore

REPEAT_S: Final = 0.25
"""Seconds between two copies of a request, and between two looks for enough keys."""

AT_ONCE: Final = 4096
"""Most names in one message."""

AUDITED: Final = "keys: the other end has said what was given before"
"""Log line: from here on the other end may be put back too, and nothing is given twice."""

POLL_S: Final = 0.05
"""Seconds between two looks into the store for new requests."""


class Asker:
    """Asks and answers for one end.

    Parameters
    ----------
    store : KeyStore
        Of this end.
    """

    hears: tuple[type[Message], ...] = (KeyRequest, KeyAnswer)
    says: tuple[type[Message], ...] = (KeyRequest, KeyAnswer)

    def __init__(self, store: KeyStore) -> None:
        self._store = store
        self._side = store.side
        self._said_at: dict[str, float] = {}
        self._look_at = -inf
        self._audits: dict[str, Asking] = {}
        self._looked_at = self._store.newest()
        self._met = False
        unused, marked = self._store.held(0, self._looked_at)
        self._audit("unused", unused)
        self._audit("marked", marked)
        self._audit("ready", ledger.ready(self._store))
        self._audit("blocks", self._store.newest_blocks())
        self._audit("lacked", self._store.blocks_held())

    def wake_at(self) -> float:
        """When :meth:`wake` is due, on the loop's clock, in seconds."""
        return self._look_at

    def wake(self, now: float) -> tuple[KeyRequest, ...]:
        """New requests, and again those that were not answered."""
        if now < self._look_at:
            return ()
        self._look_at = now + POLL_S
        self._audit_newer()
        said_at, said = {}, []
        for use, what, names in (*self._audits.values(), *pending(self._store)):
            said_at[use] = self._said_at.get(use, -inf)
            if now >= said_at[use] + REPEAT_S:
                said_at[use] = now
                said.append(KeyRequest(side=self._side, use=use, what=what, names=names))
        self._said_at = said_at
        return tuple(said)

    def _pending(self) -> tuple[KeyRequest, ...]:
        """Requests that the other end has not answered."""
        return tuple(
            KeyRequest(side=self._side, use=use, what=what, names=names)
            for use, what, names in pending(self._store)
        )

    def receive(self, kind: type[Message], payload: bytes) -> Actions:
        """Take a request or an answer of the other end; this end's own are ignored."""
        try:
            if kind is KeyRequest:
                return self._asked(KeyRequest.model_validate_json(payload))
            return self._answered(KeyAnswer.model_validate_json(payload))
        except ValidationError as error:
            text = f"keys: {error.error_count()} fields not as expected; ignored"
            return Actions(notices=(Notice(text, "warning", "malformed"),))

    def _asked(self, request: KeyRequest) -> Actions:
        if request.side == self._side:
            return Actions()
        store, what, names = self._store, request.what, request.names
        first: tuple[KeyRequest, ...] = ()
        refused: Sequence[str]
        if what == "pads":
            refused = ledger.mark(store, request.use, names)
        elif what == "keys":
            refused = store.mark(request.use, names)
        elif what == "blocks":
            refused = store.blocks_beyond(names, AT_ONCE)
        elif what == "lacked":
            refused = store.lacking(names)
        else:
            # what waits for the other end's mark counts as given: it hears of that one first
            first = self._pending()
            if what == "ready":
                refused = ledger.given_before(store, names)
            else:
                refused = store.given_before(what, names)
        answer = KeyAnswer(side=request.side, use=request.use, what=what, refused=tuple(refused))
        return Actions(publish=(*first, answer))

    def _answered(self, answer: KeyAnswer) -> Actions:
        if answer.side != self._side:
            return Actions()
        store, what, refused = self._store, answer.what, answer.refused
        if what == "pads":
            erased = ledger.answered(store, answer.use, refused)
        elif what == "keys":
            erased = store.answered(answer.use, refused)
        elif answer.use not in self._audits:
            return Actions()  # of a former process
        else:
            return self._audited(what, answer)
        return Actions(notices=_erased(what, erased))

    def _audited(self, what: What, answer: KeyAnswer) -> Actions:
        """Erase what was given before, as the other end says."""
        if what == "ready":
            erased = ledger.were_given(self._store, answer.refused)
        elif what == "blocks":
            self._store.lose(answer.refused)
            erased = 0
        elif what == "lacked":
            erased = self._store.doubt(answer.refused)
        elif what in ("unused", "made", "marked"):
            erased = self._store.were_given(what, answer.refused)
        else:
            return Actions()
        del self._audits[answer.use]
        notices = _erased(what, erased)
        self._audit_newer()  # a block may have been made before it was known to be lost
        if not self._audits and not self._met:
            self._met = True
            notices = (*notices, Notice(AUDITED))
        return Actions(notices=notices)

    def _audit_newer(self) -> None:
        """Ask about keys made since the start: an older journal makes some a second time."""
        newest = self._store.newest()
        if newest > self._looked_at:
            unused, _ = self._store.held(self._looked_at, newest)
            self._looked_at = newest
            if unused:
                self._audit("made", unused)

    def _audit(self, what: What, names: Sequence[str]) -> None:
        for at in range(0, max(1, len(names)), AT_ONCE):
            use = new_use("audit")
            self._audits[use] = Asking(use, what, tuple(names[at : at + AT_ONCE]))


def _erased(what: What, erased: int) -> tuple[Notice, ...]:
    if not erased:
        return ()
    things = "sets of pads" if what in ("pads", "ready") else "keys"
    text = f"{erased} {things} erased: the other end says that they were given, or has them no "
    return (Notice(f"{text}more; was a key store put back?", "warning", "erased"),)
