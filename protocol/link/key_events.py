"""What a side traces and logs of its key blocks; nothing in it is secret."""

from typing import Any, NamedTuple

from protocol.link.endpoint import Actions, Notice
from protocol.link.events import Event
from protocol.link.keying import Keying
from protocol.secret.blocks import Stored
from protocol.secret.tasks import Broken, Done, Judged


class BlockStored(NamedTuple):
    """A key block was stored; ``keys`` were made of it."""

    session: str
    number: int
    keys: int

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "block", **self._asdict()}


class BlockJudged(NamedTuple):
    """The partner's word on a key block is on disk: it was confirmed, or it differed."""

    session: str
    number: int
    what: str

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "judged", **self._asdict()}


def key_actions(keying: Keying, done: Done) -> Actions:
    """What an end does when the keeper of keys has done a task."""
    tasks = keying.done(done)
    return Actions(events=key_events(done), keys=tasks, notices=key_notices(done, keying))


def key_events(done: Done) -> tuple[Event, ...]:
    """What goes to the trace when the keeper has done a task."""
    if isinstance(done, Stored):
        return (BlockStored(done.session, done.number, done.keys),)
    if isinstance(done, Judged):
        return (BlockJudged(done.session, done.number, done.what),)
    return ()


def key_notices(done: Done, keying: Keying) -> tuple[Notice, ...]:
    """What goes to the log."""
    if isinstance(done, Broken):
        return (Notice(f"no key is made from here on: {done.reason}", "error"),)
    if isinstance(done, Judged):
        name = f"key block {done.number} of session {done.session}"
        if done.what == "unequal":
            return (Notice(f"{name} differs from the partner's: erased", "error"),)
        return ()
    if done.exhausted:
        return (Notice("no pad is left to sign key blocks with: make a new secret", "error"),)
    if done.keys and done.number == 0 and not done.confirmed and keying.schedule is not None:
        claim = keying.schedule.assumption.sentence()
        return (Notice(f"first keys of session {done.session}: {claim}"),)
    return ()
