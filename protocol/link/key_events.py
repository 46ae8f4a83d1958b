"""What a side traces and logs of its key blocks; nothing in it is secret."""

from typing import Any, NamedTuple

from protocol.link.events import Event
from protocol.link.keying import Keying
from protocol.link.peer import NOTHING_TO_DO, Actions, Notice
from protocol.secret.blocks import BlockResult, Stored
from protocol.secret.tasks import Broken, CoinKeys, Done


class BlockStored(NamedTuple):
    """A key block was stored; ``keys`` were made of it."""

    session: str
    number: int
    keys: int

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "block", **self._asdict()}


class Appearances(NamedTuple):
    """A message leaves this end so many ``times`` from step k on, give or take one."""

    session: str | None
    k: int
    times: int

    def as_event(self) -> dict[str, Any]:
        """As a line of a trace."""
        return {"event": "appearances", **self._asdict()}


def appeared(keying: Keying, session: str | None, k: int, count: int) -> Actions:
    """Actions of an end after its number of links has changed."""
    changed = keying.appear(count)
    if not keying.on:
        return NOTHING_TO_DO
    notices: tuple[Notice, ...] = ()
    if changed and keying.crowded:
        notices = (Notice(f"keys stop: {keying.crowded}", "error", "appearances"),)
    elif changed:
        text = f"keys go on: a message leaves {count} {'time' if count == 1 else 'times'} again"
        notices = (Notice(text, "info", "appearances"),)
    return Actions(events=(Appearances(session, k, count),), notices=notices)


def key_actions(keying: Keying, done: Done) -> Actions:
    """Actions of an end after the key maker has done a task."""
    tasks = keying.done(done)
    return Actions(events=key_events(done), keys=tasks, notices=key_notices(done, keying))


def waiting_notice(keying: Keying) -> tuple[Notice, ...]:
    """A warning of an end that stops: so many blocks are not confirmed, and give no key yet."""
    if not keying.waiting:
        return ()
    text = f"key blocks that wait for the other end: {keying.waiting}; their keys come with the "
    return (Notice(f"{text}next start of both ends", "warning"),)


def key_events(done: Done) -> tuple[Event, ...]:
    """Trace events of a task that the key maker has done."""
    if isinstance(done, Stored):
        return (BlockStored(done.session, done.number, done.keys),)
    if isinstance(done, BlockResult):
        return (done,)
    return ()


def key_notices(done: Done, keying: Keying) -> tuple[Notice, ...]:
    """Log lines of a task that the key maker has done."""
    if isinstance(done, Broken):
        return (Notice(f"no key is made from here on: {done.reason}", "error"),)
    if isinstance(done, BlockResult):
        name = f"key block {done.number} of session {done.session}"
        if done.what == "unequal":
            return (Notice(f"{name} differs from the partner's: erased", "error"),)
        return ()
    if isinstance(done, CoinKeys):
        return ()
    if done.keys and done.number == 0 and not done.confirmed and keying.schedule is not None:
        claim = keying.schedule.assumption.sentence()
        return (Notice(f"first keys of session {done.session}: {claim}"),)
    return ()
