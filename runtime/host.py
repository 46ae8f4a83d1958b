"""The shell: any number of endpoints on two buses, in one process.

Two threads take turns. The *field thread* blocks on the field bus and makes the steps. The *main
thread* wakes whoever is due, and hears the management bus and signals. A service is a host with one
endpoint; a fleet's has many, on subscriptions that fit every loop.
"""

import heapq
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Final

from protocol.link.effects import Effects, Notice, Save
from protocol.link.endpoint import Endpoint
from protocol.messages import FIELD as FIELD_MESSAGES
from protocol.messages import Message
from protocol.secret.blocks import ClosedBlock, ExtractedBlock, ExtractionFailed
from protocol.topics import every_loop, key_of
from runtime.bus import Bus, BusChannel, ChannelClosed, Publisher
from runtime.errors import DONE, Failure
from runtime.health import HealthFiles, HealthWriter
from runtime.inbox import Inbox
from runtime.perform import perform
from runtime.ports import Files, LoopPorts
from runtime.turn_watch import TurnWatch

if TYPE_CHECKING:
    from runtime.extraction import Extraction

POLL_S: Final = 0.1
"""Longest wait before the loop looks at its signals again."""

LAST_S: Final = 2.0
"""Seconds that closing waits for the lock: an interrupt may have left it held."""

CAPACITY: Final = 8192
"""Messages that may wait on the field bus; the newest push out the oldest."""

AT_ONCE: Final = 16
"""Messages or wakes that one thread handles before the other has its turn."""

TURN_S: Final = 0.002
"""Longest turn in seconds; after it newer messages are taken in."""

BACKLOG: Final = 256
"""Messages of a single loop that may wait in order; of a fleet as many as there are loops. Where
more do, the newest of each loop takes its first's place: an answer to an older one would come too
late, and so would every answer after it."""

FIELD: Final = frozenset(FIELD_MESSAGES)
"""What travels on the field bus; all else is on the management bus."""


@dataclass(slots=True)
class _Hosted:
    """One end that the host runs, and the id of its loop."""

    name: str
    endpoint: Endpoint
    field_bus: Bus
    ports: LoopPorts = field(init=False)
    wakes_at: float = inf  # the earliest entry of the heap that is this one's
    started: bool = False
    failed: Exception | None = None  # what it has done last may be carried out in part
    on_failure: Callable[[Exception], None] | None = None
    appearances: int = 0  # of a message of the field bus, as the endpoint was told; 0: not yet


class Sparing:
    """A publisher that drops messages while ``crowding`` is true; the partner sees lost messages.

    A link that opens between a message and its put would be one more chance to hear it.
    """

    def __init__(self, publisher: Publisher, crowding: Callable[[], bool]) -> None:
        self._put = publisher.put
        self._crowding = crowding

    def put(self, payload: bytes) -> None:
        """Publish, or drop it."""
        if not self._crowding():
            self._put(payload)


class FairLock:
    """A lock that two threads take in turns: a thread that releases it lets the other in first."""

    def __init__(self) -> None:
        self._gate = threading.Lock()
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        with self._gate:
            self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextmanager
    def last(self) -> Iterator[None]:
        """The last turn, after :data:`LAST_S` at most: an interrupt may have left it taken."""
        taken = self._lock.acquire(timeout=LAST_S)
        try:
            yield
        finally:
            if taken:
                self._lock.release()


class Host:
    """Runs endpoints until they are over, or until it is told to stop.

    Parameters
    ----------
    field_bus, management : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    fleet : bool
        A loop that fails is dropped and logged, and the host goes on until it is stopped. Otherwise
        the host is there for its loops: it ends with them, and with the first that fails.
    """

    def __init__(
        self,
        field_bus: Bus,
        management: Bus,
        stopping: threading.Event,
        *,
        fleet: bool = False,
    ) -> None:
        self.field, self._management = field_bus, management
        self._stopping = stopping
        self.fleet = fleet
        self._loops: dict[str, _Hosted] = {}
        self._by_key: dict[str, tuple[_Hosted, type[Message]]] = {}
        self._wakes: list[tuple[float, str]] = []
        self._inbox: Inbox[Callable[[], None]] = Inbox()
        """What the main thread does next, under the lock."""
        self._subscribed: set[str] = set()
        self._channels: list[BusChannel] = []
        self._threads: list[threading.Thread] = []
        self._extraction: Extraction | None = None
        self._health = HealthWriter()
        self.turns = FairLock()
        self._turn = TurnWatch(__name__)
        self._sleeps_until = -inf
        self._dropped = 0
        self._error: BaseException | None = None
        self._code = DONE

    @property
    def loops(self) -> tuple[str, ...]:
        """The loops that run."""
        return tuple(self._loops)

    def add(
        self,
        loop: str,
        endpoint: Endpoint,
        files: Files,
        log: logging.Logger,
        field_bus: Bus | None = None,
        on_failure: Callable[[Exception], None] | None = None,
    ) -> None:
        """Take in one more end, under the id of its loop; its files are closed when it is over.

        Parameters
        ----------
        loop, endpoint, files, log
        field_bus : Bus, optional
            The field bus as this end has it, with somebody who listens.
        on_failure : callable, optional
            Takes the error that this end has failed with, once its files are closed.
        """
        hosted = _Hosted(loop, endpoint, field_bus or self.field, on_failure=on_failure)
        with self.turns:
            publishers: dict[type[Message], Publisher] = {}
            for kind in endpoint.sends:
                bus = hosted.field_bus if kind in FIELD else self._management
                publishers[kind] = bus.publisher(key_of(kind, loop), many=self.fleet)
                if endpoint.makes_keys and kind in FIELD:
                    publishers[kind] = Sparing(publishers[kind], partial(self._crowding, hosted))
            extract = self._extracting(hosted) if endpoint.makes_keys else None
            told = partial(self._health.put, HealthFiles(files.health, log))
            hosted.ports = LoopPorts(files, publishers, log, told, extract)
            self._loops[loop] = hosted
            for kind in endpoint.receives:
                self._by_key[key_of(kind, loop)] = (hosted, kind)
        for kind in endpoint.receives:
            self.subscribe(kind, every_loop(kind) if self.fleet else key_of(kind, loop))

    def subscribe(self, kind: type[Message], key_expr: str) -> None:
        """Hear what comes on a key, once for all loops."""
        if key_expr in self._subscribed:
            return
        self._subscribed.add(key_expr)
        if kind in FIELD:
            channel = self.field.channel(key_expr, CAPACITY)
            self._channels.append(channel)
            thread = threading.Thread(target=self._listen, args=(channel,), daemon=True)
            self._threads.append(thread)
            return

        def deliver(key: str, payload: bytes, _t_ns: int) -> None:
            self._inbox.put(partial(self._hear, key, payload), len(payload))

        self._management.subscribe(key_expr, deliver)

    def _extracting(self, loop: _Hosted) -> Callable[[ClosedBlock], None]:
        """What has the key blocks of a loop extracted."""
        if self._extraction is None:
            from runtime.extraction import Extraction  # what others need not load

            self._extraction = Extraction()

        def tell(block: ExtractedBlock | ExtractionFailed) -> None:
            self._inbox.put(partial(self._extracted, loop, block), None)

        return partial(self._extraction.put, tell=tell)

    # --- the two threads --------------------------------------------------------------------------

    def run(self) -> int:
        """Run until stopped, or until every end is over; returns the exit code.

        Raises
        ------
        Failure, OSError, TransportError
            Whatever an endpoint, a file or a bus cannot go on after.
        """
        try:
            with self._turn:
                self._go_on()
        except BaseException as why:
            try:
                self.close()
            except Exception as also:  # why it ends is what counts, and what is told
                why.add_note(f"and while it ended: {type(also).__name__}: {also}")
            raise
        self.close()
        return self._code

    def _go_on(self) -> None:
        for loop in list(self._loops.values()):
            with self.turns:
                self._do(loop, loop.endpoint.start)
        for thread in self._threads:
            thread.start()
        while (self.fleet or self._loops) and not self._stopping.is_set():
            self._wake()
            self._take()
        if self._error is not None:
            raise self._error

    def _listen(self, channel: BusChannel) -> None:
        """The field bus's own thread: nobody else is woken for a step."""
        waiting: deque[tuple[str, bytes]] = deque()
        try:
            while True:
                waiting.extend(channel.receive(wait=not waiting))
                if len(waiting) > (len(self._loops) if self.fleet else BACKLOG):
                    waiting = deque(dict(waiting).items())
                with self.turns:
                    until = time.monotonic() + TURN_S
                    for _ in range(min(len(waiting), AT_ONCE)):
                        self._hear(*waiting.popleft())
                        if time.monotonic() >= until:
                            break
        except ChannelClosed:
            pass
        except BaseException as error:
            self._error = error
            self._stopping.set()
            self._inbox.put(_look_up, None)

    def _wake(self) -> None:
        """Wake some who are due, so that offers get through between them.

        Where more are due, as in a lasting overload, a message of the management bus and the signal
        to stop have their turn before these.
        """
        with self.turns:
            now = time.monotonic()
            for _ in range(AT_ONCE):
                if not self._wakes or self._wakes[0][0] > now:
                    break
                at, name = heapq.heappop(self._wakes)
                loop = self._loops.get(name)
                if loop is None or at != loop.wakes_at:  # gone, or overtaken by an earlier one
                    continue
                loop.wakes_at = inf
                if loop.endpoint.wake_at() <= now:
                    self._do(loop, loop.endpoint.wake)
                else:
                    self._schedule(loop)
            until = self._wakes[0][0] if self._wakes else inf
            self._sleeps_until = min(until, now + POLL_S)

    def _take(self) -> None:
        """Wait for a message on the management bus or a key block, or for the next wake."""
        try:
            act = self._inbox.get(timeout=max(self._sleeps_until - time.monotonic(), 0.0))
        except queue.Empty:
            return
        if self._inbox.dropped > self._dropped:
            self._dropped = self._inbox.dropped
            text = f"messages come faster than they are taken: {self._dropped} dropped so far"
            for loop in list(self._loops.values())[:1]:
                loop.ports.log_notice(Notice(text, "warning", "flood"))
        with self.turns:
            act()

    # --- under the lock ---------------------------------------------------------------------------

    def _look_at_links(self, loop: _Hosted) -> None:
        """Tell an end how often its messages leave, where that has changed."""
        count = self.field.appearances()
        if count != loop.appearances:
            loop.appearances = count
            perform(loop.endpoint.appear(count), loop.ports.do)

    def _crowding(self, loop: _Hosted) -> bool:
        """Whether messages leave more often than the end knew when it made its last one.

        It is asked before each message leaves; the end is told before it acts again.
        """
        return self.field.appearances() > loop.appearances

    def _hear(self, key: str, payload: bytes) -> None:
        if key not in self._by_key:
            return
        loop, kind = self._by_key[key]
        if kind in FIELD:
            loop.field_bus.taken(key, payload)
        self._do(loop, lambda now: loop.endpoint.receive(kind, payload, now))

    def _extracted(self, loop: _Hosted, block: ExtractedBlock | ExtractionFailed) -> None:
        """A key block of a loop is extracted, or none can be any more."""
        if loop.name in self._loops:
            self._do(loop, lambda _now: loop.endpoint.extracted(block))

    def _do(self, loop: _Hosted, act: Callable[[float], Effects]) -> None:
        try:
            if loop.started:  # a device may take its time to be found
                if loop.endpoint.makes_keys:
                    self._look_at_links(loop)
                self._turn.begin()
            perform(act(time.monotonic()), loop.ports.do)
            loop.started = True
        except Exception as error:
            loop.failed = error
            if not self.fleet:
                raise
            loop.ports.log.error("loop %s is over: %s: %s", loop.name, type(error).__name__, error)
            self._end(loop)
            return
        finally:
            self._turn.over()
        code = loop.endpoint.code
        if code is not None:
            self._code = max(self._code, code)
            self._end(loop)
            return
        self._schedule(loop)

    def _schedule(self, loop: _Hosted) -> None:
        due = loop.endpoint.wake_at()
        if due < loop.wakes_at:
            loop.wakes_at = due
            heapq.heappush(self._wakes, (due, loop.name))
            if due < self._sleeps_until:
                self._sleeps_until = due
                self._inbox.put(_look_up, None)

    def _end(self, loop: _Hosted) -> None:
        """Stop an end and close its files."""
        if self._loops.pop(loop.name, None) is None:
            return
        for kind in loop.endpoint.receives:
            self._by_key.pop(key_of(kind, loop.name), None)
        try:
            with self._lost(loop, OSError, Failure):
                last = loop.endpoint.stop(time.monotonic())
                if loop.failed is not None:  # what the journal has is done again by the next start
                    last = (effect for effect in last if not isinstance(effect, Save))
                perform(last, loop.ports.do)
        finally:
            with self._lost(loop):
                loop.ports.close()
            if loop.failed is not None and loop.on_failure is not None:
                loop.on_failure(loop.failed)
            self.field.left(loop.name)
            self._management.left(loop.name)
        if not self._loops:
            self._inbox.put(_look_up, None)

    @contextmanager
    def _lost(self, loop: _Hosted, *kinds: type[Exception]) -> Iterator[None]:
        """Log an error of these kinds in an end's last moments; of a fleet's end any error."""
        try:
            yield
        except Exception as error:
            if not self.fleet and not isinstance(error, kinds):
                raise
            loop.ports.log.warning("the last word is lost: %s", error)

    def close(self) -> None:
        """Stop every end and close its files, each also where another fails."""
        with ExitStack() as last:  # from below
            if self._extraction is not None:
                last.callback(self._extraction.close)
            last.callback(self._health.close, LAST_S)
            last.callback(self._end_all)
            for thread in self._threads:
                if thread.ident is not None:  # an interrupt may have come before it was started
                    last.callback(thread.join, LAST_S)
            for channel in self._channels:
                last.callback(channel.close)

    def _end_all(self) -> None:
        with self.turns.last(), ExitStack() as ends:
            for loop in reversed(self._loops.values()):
                ends.callback(self._end, loop)


def _look_up() -> None:
    """Nothing to do, but the main thread is to look at its timers and signals now."""
