"""The tap service: mirrors the field bus to disk, then lets the eavesdroppers guess.

A thin shell. The transport's thread only puts messages on a queue. The main thread takes them off,
writes each to the capture before anything else, and feeds the eavesdroppers that cost microseconds
a step; the heavy ones read the capture in a process of their own (:mod:`tap_service.analysis`).
"""

import logging
import os
import queue
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from pydantic import ValidationError
from pydantic_core import from_json, to_json

from protocol.messages import FIELD, FieldMessage, TapStatus
from protocol.topics import key_of
from runtime.collection import freeze_startup
from runtime.errors import DONE
from runtime.files import StatusFile
from runtime.inbox import Inbox
from runtime.logs import RateLimitedLog, logger
from runtime.rates import Throttle
from runtime.run_folder import BELIEFS, CAPTURE, GUESSES, TAP_STATUS
from runtime.signals import stop_on_signals
from tap_service.analysis import Assignment, Listeners, listeners_of
from tap_service.capture.channel import WiretapChannel
from tap_service.capture.recording import RotatingLog, malformed_line, mirror_line
from tap_service.capture.transcript import Transcript
from tap_service.config import SILENT_S, TapConfig, eighth
from tap_service.heavy import HeavyProcess
from tap_service.sandboxed import each_once, sandboxed
from tap_service.status import (
    absent_record,
    absent_status,
    belief_record,
    beliefs_json,
    status_of,
    unused_of,
)

if TYPE_CHECKING:
    from runtime.addresses import Addresses
    from runtime.bus import Bus

STATUS_PERIOD_S: Final = 0.2
"""Between two statuses of one eavesdropper."""

BELIEFS_PERIOD_S: Final = 2.0
"""Between two writings of ``beliefs.json``."""

TOO_FAR_BEHIND: Final = 5000
"""Steps of backlog from which the tap does not keep up."""

GATHER_S: Final = 0.05
"""Rest after the queue was empty, in which messages gather: waking up for each one would take
processor time from the loop that is listened to."""

NICENESS: Final = 10
"""Guessing gives way to the loop where they share a processor."""

QUEUE_BYTES: Final = 64 * 2**20
"""Bytes that may wait for the mirror in one process; what comes beyond them is dropped and
counted."""

TOO_MANY_UNUSED: Final = 0.01
"""Share of the messages that the tap heard and could not use, from which its health is bad."""

BUSY_LENGTH: Final = 20_000
"""Messages that wait when the light eavesdroppers are left out, so that the mirror catches up."""

Note = Callable[["Bus"], AbstractContextManager["Bus"]]
"""What else is done with the bus that statuses are published on, such as metrics."""


class Listens(Protocol):
    """A tap, or the taps of a fleet."""

    log: logging.Logger

    def attach(self, field_bus: "Bus", adversary_bus: "Bus") -> None:
        """Subscribe to the field messages, and publish on the adversary bus."""

    def run(self, stopping: threading.Event) -> None:
        """Mirror, guess and publish until ``stopping``; then guess what is left."""

    def close(self) -> None:
        """End the files and the analysis process."""


def run_tap(
    make: Callable[[], Listens], field: "Addresses", adversary: "Addresses", note: Note
) -> int:
    """Run until SIGTERM or SIGINT; returns the exit code.

    Raises
    ------
    KnowledgeError
        When an eavesdropper cannot be made.
    runtime.bus.TransportError
        When a bus cannot be opened; nothing has started in either case.
    """
    from runtime.link_watchdog import watched
    from runtime.zenoh_bus import open_bus

    with ExitStack() as stack:
        stopping = stack.enter_context(stop_on_signals())
        # Eavesdroppers are made first: from the moment that a bus is open whoever waits for the
        # tap goes on, and what is said then must be heard.
        service = make()
        stack.callback(service.close)
        field_bus = stack.enter_context(open_bus(field))
        told_on = stack.enter_context(open_bus(adversary))
        service.attach(field_bus, stack.enter_context(note(told_on)))
        buses = field_bus, told_on
        stack.enter_context(
            watched(stopping, service.log, *buses, listens=field_bus, silent_s=SILENT_S)
        )
        # On Linux this is the calling thread's alone: the transport's threads, already
        # running, still take messages off the wire at once.
        os.nice(NICENESS)
        freeze_startup()
        service.run(stopping)
    return DONE


class TapService:
    """The tap between its buses and its files; `run_tap` wires it to Zenoh and to signals."""

    def __init__(self, config: TapConfig) -> None:
        self.log: logging.Logger = logger("tap")
        self._config = config
        each_once(config.names)
        knowledge = {name: config.knowledge_of(name) for name in config.names}
        heavy = tuple(name for name in config.names if sandboxed(name).heavy)
        listeners_of(heavy, knowledge)  # an error is told here, before anything starts
        light = [name for name in config.names if name not in heavy]
        self._made = listeners_of(light, knowledge, self.log)
        self._heavy = heavy, knowledge
        self._begun = False
        self._clear = config.view.clear
        self._channel = WiretapChannel(config.view)
        self._transcript = Transcript()
        self.queue: Inbox[tuple[str, bytes, int]] = Inbox()
        self.share(1)
        self._complaints = RateLimitedLog(self.log)
        self._types = {key_of(kind, config.loop): kind for kind in FIELD}
        self._put: Callable[[bytes], None] | None = None
        self._unheard = 0
        self._seq = 0
        self._records: dict[str, dict[str, Any]] = {}
        self._heavy_status: dict[str, tuple[TapStatus, int]] = {}
        self._beliefs_file = StatusFile(config.run_dir / BELIEFS)
        self._status_file = StatusFile(config.run_dir / TAP_STATUS)
        self._restarts = _starts_before(config.run_dir)
        self.heavy: HeavyProcess | None = None
        self._heavy_names = tuple(sandboxed(name).name for name in heavy)

    def begin(self) -> None:
        """Begin the recordings, and the analysis process; until then nothing is written."""
        config, header = self._config, self._config.header()
        guesses = eighth(config.limits)
        self.capture = RotatingLog(config.run_dir / CAPTURE, header, config.limits, self.log)
        self._guesses = RotatingLog(config.run_dir / GUESSES, header, guesses, self.log)
        self.listeners = Listeners(self._made, self._guesses)
        heavy, knowledge = self._heavy
        if heavy:
            assignment = Assignment(config.run_dir, heavy, knowledge, guesses, header)
            self.heavy = HeavyProcess(assignment, self.log)
        self._begun = True

    # --- the wire ---------------------------------------------------------------------------------

    def attach(self, field_bus: "Bus", adversary_bus: "Bus") -> None:
        """Begin, subscribe to the field messages, and publish on the adversary bus."""
        self.begin()
        for key in self.keys:
            field_bus.subscribe(key, self.deliver, patient=True)
        self.publish_on(adversary_bus)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that are listened to."""
        return tuple(self._types)

    def publish_on(self, adversary_bus: "Bus", *, many: bool = False) -> None:
        """Publish statuses there; of a fleet one of ``many``."""
        self._put = adversary_bus.publisher(key_of(TapStatus, self._config.loop), many=many).put

    def share(self, taps: int) -> None:
        """So many taps are in this process: each may keep a share of what one may keep waiting."""
        self.queue.room = QUEUE_BYTES // taps
        self._busy_length = BUSY_LENGTH // taps

    def deliver(self, key: str, payload: bytes, t_ns: int) -> None:
        """Take one message from the transport; runs on its thread, so it only enqueues."""
        self.queue.put((key, payload, t_ns), len(payload))

    # --- the loop ---------------------------------------------------------------------------------

    def run(self, stopping: threading.Event) -> None:
        """Mirror, guess and publish until ``stopping``; then guess what is left."""
        names = ", ".join(self._config.names) or "none"
        self.log.info("listening on loop %s, eavesdroppers: %s", self._config.loop, names)
        status = Throttle(STATUS_PERIOD_S)
        beliefs = Throttle(BELIEFS_PERIOD_S)
        while not stopping.is_set():
            self.work(0.05)
            time.sleep(GATHER_S)
            now = time.monotonic()
            if status.ready(now):
                self.publish()
            if beliefs.ready(now):
                self.write_beliefs()
        self.finish()

    def work(self, wait_s: float) -> None:
        """Take what is on the queue, for at most ``STATUS_PERIOD_S``; wait for a first message.

        What came of it is with the operating system on return.
        """
        take = self.queue.get
        try:
            item = take(wait_s)
        except queue.Empty:
            return
        until = time.monotonic() + STATUS_PERIOD_S
        try:
            while True:
                self._take(*item)
                if time.monotonic() >= until:
                    break
                item = take(0.0)
        except queue.Empty:
            pass
        self.capture.flush()
        self._guesses.flush()

    def _take(self, key: str, payload: bytes, t_ns: int) -> None:
        kind = self._types.get(key)
        if kind is None:
            return
        try:
            message = kind.model_validate_json(payload)
        except ValidationError as error:
            self.capture.write(malformed_line(t_ns, key, payload))
            first = error.errors(include_url=False, include_context=False)[0]["msg"]
            self._complaints.add(f"{key}: undecodable: {first}")
            return
        if self._clear:
            self.capture.write(mirror_line(t_ns, kind.topic, payload))
            self._hear(message)
            return
        for seen_ns, seen in self._channel.hear(t_ns, message):
            self._see(seen_ns, seen)

    def _see(self, t_ns: int, message: FieldMessage) -> None:
        payload = message.wire()
        self.capture.write(mirror_line(t_ns, message.topic, payload))
        self._hear(message)

    def _hear(self, message: FieldMessage) -> None:
        if len(self.queue) > self._busy_length:
            self._unheard += 1
            return
        self.listeners.hear(message, self._transcript.hear(message))

    def finish(self) -> None:
        """Settle what is left, at the end: the queue, held messages, the heavy ones' backlog."""
        while self.queue:
            self.work(0.0)
        for seen_ns, seen in self._channel.rest():
            self._see(seen_ns, seen)
        self.listeners.feed(self._transcript.flush())
        self.capture.close()
        if self._unheard:
            self.log.warning(
                "%d messages were mirrored and not guessed at, as too many waited: "
                "wyner score RUN --eavesdropper NAME guesses at all of them",
                self._unheard,
            )
        for listener in self.listeners.listeners:
            self.listeners.review(listener)
        self._guesses.flush()
        self.publish(last=True)
        self.write_beliefs()
        if self.heavy is not None:
            for report in self.heavy.finish(self._config.finish_s):
                self._note(*report)
                self.write_beliefs()
            self._note_down()
            self.publish(last=True)
            self.write_beliefs()

    # --- what is told -----------------------------------------------------------------------------

    def _counts(self) -> dict[str, int]:
        """The service's own figures, which are in every status."""
        self._seq += 1
        return {
            "seq": self._seq,
            "t_ns": time.time_ns(),
            "mirrored": self.capture.written,
            "dropped": self._dropped(),
            "malformed": self._complaints.total,
        }

    def _note(self, status: TapStatus, record: dict[str, Any]) -> None:
        self._heavy_status[status.name] = status, self.capture.written
        self._records[status.name] = record

    def _note_down(self) -> None:
        """Where nobody runs in the heavy ones' process: what each said last is not said anew."""
        if self.heavy is None or not self.heavy.down:
            return
        for name in self._heavy_names:
            status, written = self._heavy_status.get(name, (absent_status(name), 0))
            status = status.model_copy(update={"failed": self.heavy.down})
            self._heavy_status[name] = status, written
            record = self._records.get(name) or absent_record(name)
            self._records[name] = record | {
                "failed": self.heavy.down,
                "behind": self._unread(status, written),
                "symbols": None,
            }

    def _unread(self, status: TapStatus, written: int) -> int:
        """Steps that a heavy one has not looked at: those of her report, and captured since."""
        return status.behind + max(self.capture.written - written, 0) // 2

    def publish(self, *, last: bool = False) -> None:
        """Publish the status of every eavesdropper."""
        statuses = []
        for listener in self.listeners.listeners:
            belief = listener.belief()
            counts = self._counts() | {"behind": self._behind(), "restarts": self._restarts}
            counts |= self._transcript.unused._asdict()
            session = self.listeners.session
            record = belief_record(session, listener, belief, last=last, counts=counts)
            self._records[listener.name] = record
            statuses.append(status_of(listener, belief, counts))
        if self.heavy is not None and not last:
            for report in self.heavy.reports():
                self._note(*report)
            self._note_down()
        for status, written in self._heavy_status.values():
            counts = self._counts() | {"behind": self._unread(status, written)}
            counts["dropped"] += status.dropped
            if self.heavy is not None:
                counts["restarts"] = self._restarts + self.heavy.restarts
            told = status.model_copy(update=counts)
            self._records[told.name]["unused"] = unused_of(told.model_dump())
            statuses.append(told)
        if self._put is not None:
            for status in statuses:
                self._put(status.wire())
        self._complaints.report_held_back(last=last)

    def _behind(self) -> int:
        """Steps, of two messages each, that the light eavesdroppers have not heard yet."""
        return -(-len(self.queue) // 2)

    def _health(self) -> str:
        """Whether she keeps up, as a line; hearing nothing is no fault of hers."""
        failed = {x.name: x.failed for x in self.listeners.listeners if x.failed}
        failed |= {s.name: s.failed for s, _ in self._heavy_status.values() if s.failed}
        if failed:
            return f"bad: {'; '.join(f'{name} failed: {why}' for name, why in failed.items())}"
        behind = max(self._behind(), *(self._unread(*x) for x in self._heavy_status.values()), 0)
        if behind > TOO_FAR_BEHIND:
            return f"bad: {behind} steps behind: more eavesdroppers than this machine can feed"
        told = f"{self.capture.written} messages captured, {behind} steps behind"
        unused = self._transcript.unused
        lost = unused.foreign + unused.late + self._dropped()
        if lost or unused.jumped:
            told += (
                f"; not used: {unused.foreign} messages of other sessions, {unused.late} late, "
                f"{self._dropped()} dropped; {unused.jumped} steps not heard"
            )
        deaf = lost + 2 * unused.jumped
        bad = deaf > TOO_MANY_UNUSED * (self.capture.written + deaf)
        return f"{'bad' if bad else 'ok'}: {told}"

    def _dropped(self) -> int:
        """Messages that were heard, and recorded or guessed at not at all."""
        return self.queue.dropped + self.capture.dropped + self._unheard

    def write_beliefs(self) -> None:
        """Write down what the eavesdroppers believe, and how much was captured."""
        captured = {
            "health": self._health(),  # first, for deploy/healthy
            "t_ns": time.time_ns(),
            "first_part": self.capture.first_part,
            "captured": self.capture.written,
            "dropped": self.queue.dropped + self.capture.dropped,
            "unguessed": self._unheard,
            "starts": self._restarts + 1,
        }
        try:
            self._beliefs_file.write(beliefs_json(self._records))
            self._status_file.write(to_json(captured))
        except OSError as error:
            self._complaints.add(f"{BELIEFS}: {error.strerror}")

    def close(self) -> None:
        """End the files and the analysis process."""
        if not self._begun:
            return
        self.capture.close()
        self._guesses.close()
        if self.heavy is not None:
            self.heavy.close()
        self._complaints.report_held_back(last=True)


def _starts_before(run_dir: Path) -> int:
    """How often a tap was started in this folder before, as far as its status tells."""
    try:
        return int(from_json((run_dir / TAP_STATUS).read_bytes())["starts"])
    except (OSError, ValueError, LookupError, TypeError):
        return 0
