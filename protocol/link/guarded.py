"""An end whose messages on the field bus are guarded: closed as they leave, opened as they come.

The end itself knows nothing of it: what it says and hears, saves and traces is plain. Sans I/O.
"""

from collections.abc import Callable
from math import inf
from typing import Any, Final, NamedTuple

from pydantic_core import from_json

from protocol.defence.base import Defence
from protocol.link.events import Forged
from protocol.link.guard import Guard, Opened, Promise
from protocol.link.peer import NOTHING_TO_DO, Actions, Notice, Peer
from protocol.messages import ControllerHello, Measurement, Message, Offer, PlantHello
from protocol.secret.blocks import BlockResult
from protocol.secret.records import Side
from protocol.secret.tasks import Broken, Done, GuardKeys, GuardTask

AHEAD: Final = 96
"""Steps before the last covered one at which more keys are asked for."""

MARGIN: Final = 12
"""Steps from the present one on that a new batch leaves out: its keys take so long to come."""

UNOPENED: Final = 64
"""Messages in a row that do not open, after which keys count as gone."""

AGAIN_S: Final = 0.1
LACKING_S: Final = 1.0
"""Seconds until keys are asked for again while they are marked, and where there were none."""


class GuardStatus(NamedTuple):
    """What a status says of it.

    Parameters
    ----------
    guarded, unguarded : int
        Messages heard under a key that both ends hold, and plain ones.
    ahead : int
        Steps to come for which this end holds keys to send under.
    forged, forged_k : int
        Messages that were refused as forgeries, and the step of the last one (-1: none).
    """

    guarded: int = 0
    unguarded: int = 0
    ahead: int = 0
    forged: int = 0
    forged_k: int = -1

    def fields(self) -> dict[str, Any]:
        """As fields of a status."""
        return {
            "guarded": self.guarded,
            "unguarded": self.unguarded,
            "guard_ahead": self.ahead,
            "forged": self.forged,
            "forged_k": self.forged_k,
        }


class Guarded:
    """A :class:`~protocol.link.peer.Peer` whose messages of the loop are guarded.

    Parameters
    ----------
    end : Peer
    side : {"controller", "plant"}
    defence : Defence
        That codes or tags.
    instance : str
        Random id of this process.
    anew : callable
        Ends the session, over a reason.
    session : str, optional
        The one that the end's journal is in.
    keys : GuardKeys, optional
        What the end's key store holds for that session.
    halt : callable, optional
        What the end does over a forgery, beside telling it.
    """

    def __init__(
        self,
        end: Peer,
        side: Side,
        defence: Defence,
        instance: str,
        anew: Callable[[str], Actions],
        session: str | None = None,
        keys: GuardKeys | None = None,
        halt: Callable[[], Actions] | None = None,
    ) -> None:
        self.hears, self.says = end.hears, end.says
        self._end, self._halt, self._anew = end, halt, anew
        self._said: type[Measurement] | type[Offer] = Measurement if side == "plant" else Offer
        self._heard: type[Measurement] | type[Offer] = Offer if side == "plant" else Measurement
        self._defence = defence
        self._out = Guard(defence, self._said.topic)
        self._in = Guard(defence, self._heard.topic)
        self._instance, self._partner = instance, ""
        self._doubtful, self._unopened = True, 0
        self._session = ""
        self._k = -1
        self._plain_k = -1
        self._asked = self._broken = False
        self._again_at = -inf
        self._promise, self._unsaid = Promise(), False
        self._lacking = self._looked = self._looks = -1
        self._status = GuardStatus()
        if session is not None:
            self._begin(session)
            if keys is not None:
                self._take(keys)

    @property
    def code(self) -> int | None:
        """The end's exit code."""
        return self._end.code

    def status(self) -> GuardStatus:
        """What a status says of it."""
        ahead = self._out.until(self._k) - self._k if self._out.on else 0
        return self._status._replace(ahead=max(0, ahead))

    def start(self, now: float) -> Actions:
        """The end's first word."""
        return self._closed(self._end.start(now), now)

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """A message came: it is opened, or refused, or waits for its key."""
        if kind in (PlantHello, ControllerHello):
            self._meet(payload)
        if kind is not self._heard or not self._in.on:
            return self._closed(self._end.receive(kind, payload, now), now)
        session, k = _place(payload)
        if session != self._session or k < 0:
            # of another session, or none: the end says so
            return self._closed(self._end.receive(kind, payload, now), now)
        opened = self._in.opened(k, payload, self._promise)
        if opened.lacking >= 0:
            self._lacking = max(self._lacking, opened.lacking)
            if self._looked < opened.lacking and not self._broken:
                return Actions(keys=self._tasks(now))  # it comes again
            opened = self._in.without(k, payload, self._promise)
        if opened.plain is None:
            return self._refused(k, opened, now)
        self._unopened = 0
        self._doubtful = self._doubtful and opened.number < 0
        tasks: tuple[GuardTask, ...] = ()
        if opened.number >= 0 and self._in.tags:
            before, self._promise = self._promise, self._promise.extended(k, opened.number)
            if before != self._promise:
                self._unsaid = True
                tasks = self._tasks(now)
        if opened.number >= 0:
            self._in.drop_below(opened.needs)
        if opened.slot >= 0:
            self._status = self._status._replace(guarded=self._status.guarded + 1)
        else:
            self._status = self._status._replace(unguarded=self._status.unguarded + 1)
        actions = self._closed(self._end.receive(kind, opened.plain, now), now)
        return actions._replace(keys=(*actions.keys, *tasks)) if tasks else actions

    def wake_at(self) -> float:
        """When the end is due."""
        return self._end.wake_at()

    def wake(self, now: float) -> Actions:
        """Whatever of the end's is due."""
        return self._closed(self._end.wake(now), now)

    def finish_step(self) -> Actions:
        """The end's rest of a step."""
        return self._closed(self._end.finish_step(), -inf)

    def key_task_done(self, done: Done, now: float) -> Actions:
        """A task of the keys is done."""
        if isinstance(done, BlockResult):
            self._again_at = -inf  # there may be keys now
        self._broken = self._broken or isinstance(done, Broken)  # nothing is looked up any more
        if not isinstance(done, GuardKeys):
            return self._closed(self._end.key_task_done(done, now), now)
        self._asked = False
        self._take(done)
        self._again_at = now + (AGAIN_S if done.pending else LACKING_S)
        return NOTHING_TO_DO

    def appear(self, count: int) -> Actions:
        """How often the end's messages leave."""
        return self._closed(self._end.appear(count), -inf)

    def stop(self, now: float) -> Actions:
        """The end's last word."""
        return self._closed(self._end.stop(now), -inf)

    # --- what is said -----------------------------------------------------------------------------

    def _closed(self, actions: Actions, now: float) -> Actions:
        """The same actions with their messages closed; and tasks, where keys run out."""
        if any(isinstance(out, self._said) for out in actions.publish):
            publish = tuple([self._close(out) for out in actions.publish])
            actions = actions._replace(publish=publish)
            if now > -inf:
                actions = actions._replace(keys=(*actions.keys, *self._tasks(now)))
        return actions

    def _close(self, out: Message) -> Message:
        if not isinstance(out, Measurement | Offer) or not isinstance(out, self._said):
            return out
        k, payload = out.k, out.wire()
        if out.session != self._session:
            self._begin(out.session)
        self._k = max(self._k, k)
        if not self._out.on or k <= self._plain_k:
            return out
        after_k = out.applied_k + 1 if isinstance(out, Measurement) else -1
        closed = self._out.closed(k, payload, after_k)
        if closed == payload:
            self._plain_k = k
        elif (number := self._out.covers(k)) >= 0:
            older = self._out.covers(after_k) if self._out.codes else -1
            self._out.drop_below(older if older >= 0 else number)
        return out.travelling_as(closed)

    def _begin(self, session: str) -> None:
        """Another session begins, with keys of its own."""
        self._session = session
        self._k = self._plain_k = self._lacking = self._looked = self._looks = -1
        self._unopened = 0
        self._promise, self._unsaid = Promise(), False
        self._out.begin()
        self._in.begin()
        self._again_at = -inf

    # --- keys -------------------------------------------------------------------------------------

    def _meet(self, payload: bytes) -> None:
        """The partner says hello: another process of its may have lost keys."""
        partner = _process(payload)
        if partner != self._partner:
            self._partner, self._doubtful, self._unopened = partner, True, 0

    def _tasks(self, now: float) -> tuple[GuardTask, ...]:
        """What the keeper of keys must do now: look for what is lacking, set more aside."""
        if self._asked or not self._session:
            return ()
        wants = now >= self._again_at and self._out.on
        wants = wants and self._out.until(self._k) < self._k + AHEAD
        if not wants and self._lacking <= self._looked and not self._unsaid:
            return ()
        self._asked, self._looks, self._unsaid = True, self._lacking, False
        guards = self._defence if self._out.on else None
        return (
            GuardTask(
                self._session,
                self._instance,
                max(0, self._k),
                max(self._k + MARGIN, self._out.end),
                0 if guards is None else guards.session_words,
                0 if guards is None else guards.step_words,
                self._out.newest,
                self._in.newest,
                self._out.oldest,
                self._in.oldest,
                wants,
                self._promise,
            ),
        )

    def _take(self, keys: GuardKeys) -> None:
        if keys.session != self._session:
            return
        self._out.add(keys.sent)
        self._in.add(keys.heard)
        if self._promise == Promise():
            self._promise = Promise(*keys.promise)
        self._looked = max(self._looked, self._looks)

    # --- what is refused --------------------------------------------------------------------------

    def _refused(self, k: int, opened: Opened, now: float) -> Actions:
        """A message that is no message of the partner's, or that cannot be opened.

        :data:`UNOPENED` of them in a row end the session where keys may have gone with a process:
        from an end's beginning on, until a message opens, and once its key store is broken. Else
        who can only forge would end it, to be heard in the next one, which begins bare. A code
        alone refuses no bare message anyway.
        """
        self._unopened += 1
        actions = NOTHING_TO_DO if not opened.why else self._forgery(k, opened.why)
        expected = self._doubtful or self._broken or not self._in.tags
        if self._unopened < UNOPENED or not expected:
            return actions
        self._session, self._unopened = "", 0
        ended = self._closed(self._anew("the keys that guard its messages are gone"), now)
        return ended._replace(
            events=(*actions.events, *ended.events),
            notices=(*actions.notices, *ended.notices),
        )

    def _forgery(self, k: int, why: str) -> Actions:
        before = self._status
        self._status = before._replace(forged=before.forged + 1, forged_k=k)
        event = Forged(self._session, k, self._heard.topic, why)
        # a step's repeats are told once
        events = (event,) if before.forged_k != k else ()
        actions = NOTHING_TO_DO if self._halt is None else self._halt()
        alarm = Notice(event.sentence(), "error", "alarms")
        return actions._replace(
            events=(*events, *actions.events), notices=(alarm, *actions.notices)
        )


def _process(payload: bytes) -> str:
    """The process that says a hello; nothing where it is none."""
    try:
        instance = from_json(payload)["instance"]
    except (KeyError, TypeError, ValueError):
        return ""
    return instance if isinstance(instance, str) else ""


def _place(payload: bytes) -> tuple[str, int]:
    """Session and step of a message; nothing where it is none."""
    try:
        message = from_json(payload)
        session, k = message["session"], message["k"]
    except (KeyError, TypeError, ValueError):
        return "", -1
    return (session, k) if isinstance(session, str) and isinstance(k, int) else ("", -1)
