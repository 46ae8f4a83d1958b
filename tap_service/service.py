"""The tap service: mirrors the field bus to disk, then lets the eavesdroppers guess.

A thin shell. The transport's thread only puts messages on a queue. The main thread takes them off,
writes each to the capture before anything else, and feeds the eavesdroppers that cost microseconds
a step; all others read the capture in processes beside it (:mod:`tap_service.beside`).
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError
from pydantic_core import from_json, to_json

from protocol.messages import FIELD, FieldMessage, TapStatus
from protocol.topics import key_of
from runtime.inbox import Inbox
from runtime.logs import Burst, RateLimitedLog, logger
from runtime.run_folder import BELIEFS, CAPTURE, GUESSES, TAP_STATUS
from runtime.status_file import StatusFile
from tap_service.beside import Beside, assignments_of
from tap_service.capture.channel import WiretapChannel
from tap_service.capture.recording import RotatingLog, malformed_line, mirror_line
from tap_service.config import TapConfig, each_once, eighth, runs_beside
from tap_service.listening import Listeners
from tap_service.status import beliefs_json, facts_of, reports_of

if TYPE_CHECKING:
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

QUEUE_BYTES: Final = 64 * 2**20
"""Bytes that may wait for the mirror in one process; what comes beyond them is dropped and
counted."""

TOO_MANY_UNUSED: Final = 0.01
"""Share of the messages that the tap heard and could not use, from which its health is bad."""

BUSY_LENGTH: Final = 20_000
"""Messages that wait when the light eavesdroppers are left out, so that the mirror catches up."""


class TapService:
    """The tap between its buses and its files."""

    def __init__(self, config: TapConfig) -> None:
        self.log: logging.Logger = logger("tap")
        self._config = config
        each_once(config.names)
        light = {n: config.knowledge_of(n) for n in config.names if not runs_beside(n)}
        self.listeners = Listeners(light, self._write_guess, self.log)
        self._assignments = assignments_of(config)
        for assignment in self._assignments:
            Listeners(assignment.told, self._write_guess, self.log)  # an error is told here
        self.beside: list[Beside] = []
        self._begun = False
        self._clear = config.view.clear
        self._channel = WiretapChannel(config.view)
        self.queue: Inbox[tuple[str, bytes, int]] = Inbox()
        self.share(1)
        self._complaints = RateLimitedLog(self.log)
        self._types = {key_of(kind, config.loop): kind for kind in FIELD}
        self._put: Callable[[bytes], None] | None = None
        self._unheard = 0
        self._seq = 0
        self._records: dict[str, dict[str, Any]] = {}
        self._beliefs_file = StatusFile(config.run_dir / BELIEFS)
        self._status_file = StatusFile(config.run_dir / TAP_STATUS)
        self._restarts = _starts_before(config.run_dir)

    def begin(self) -> None:
        """Begin the recordings, and the processes beside; until then nothing is written."""
        config, header = self._config, self._config.header()
        self.capture = RotatingLog(config.run_dir / CAPTURE, header, config.limits, self.log)
        guesses = config.run_dir / GUESSES
        self._guesses = RotatingLog(guesses, header, eighth(config.limits), self.log)
        self.beside = [Beside(assignment, self.log) for assignment in self._assignments]
        self._begun = True

    def _write_guess(self, line: bytes) -> None:
        self._guesses.write(line)

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
        status = Burst(1, 1 / STATUS_PERIOD_S)
        beliefs = Burst(1, 1 / BELIEFS_PERIOD_S)
        while not stopping.is_set():
            self.work(0.05)
            time.sleep(GATHER_S)
            now = time.monotonic()
            if status.allows(now):
                self.publish()
            if beliefs.allows(now):
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
        self.listeners.hear(message)

    def finish(self) -> None:
        """Settle what is left, at the end: the queue, held messages, the backlog beside."""
        while self.queue:
            self.work(0.0)
        for seen_ns, seen in self._channel.rest():
            self._see(seen_ns, seen)
        self.capture.close()
        if self._unheard:
            self.log.warning(
                "%d messages were mirrored and not guessed at, as too many waited: "
                "wyner score RUN --eavesdropper NAME guesses at all of them",
                self._unheard,
            )
        self.listeners.finish()
        self._guesses.flush()
        self.publish(last=True)
        self.write_beliefs()
        deadline = time.monotonic() + self._config.finish_s
        for process in self.beside:
            process.finish()
        for process in self.beside:
            for _ in process.last_reports(deadline, self.capture.written):
                self.publish(last=True)
                self.write_beliefs()
        self.publish(last=True)
        self.write_beliefs()

    # --- what is told -----------------------------------------------------------------------------

    def publish(self, *, last: bool = False) -> None:
        """Publish the status of every eavesdropper."""
        reports = list(reports_of(self.listeners, behind=self._behind(), last=last))
        for process in self.beside:
            reports += process.reports(self.capture.written)
        for its, record in reports:
            self._seq += 1
            unused = its.unused.model_copy(
                update={
                    "dropped": self._dropped(),
                    "malformed": self._complaints.total,
                    "restarts": its.unused.restarts + self._restarts,
                }
            )
            status = its.model_copy(
                update={
                    "seq": self._seq,
                    "t_ns": time.time_ns(),
                    "mirrored": self.capture.written,
                    "unused": unused,
                }
            )
            self._records[status.name] = record | facts_of(status)
            if self._put is not None:
                self._put(status.wire())
        self._complaints.report_held_back(last=last)

    def _behind(self) -> int:
        """Steps, of two messages each, that the light eavesdroppers have not heard yet."""
        return -(-len(self.queue) // 2)

    def _health(self) -> str:
        """Whether she keeps up, as a line; hearing nothing is no fault of hers."""
        records = self._records.values()
        failed = [f"{one['name']} failed: {one['failed']}" for one in records if one["failed"]]
        if failed:
            return f"bad: {'; '.join(failed)}"
        behind = max(self._behind(), *(one["behind"] for one in records), 0)
        if behind > TOO_FAR_BEHIND:
            return f"bad: {behind} steps behind: more eavesdroppers than this machine can feed"
        told = f"{self.capture.written} messages captured, {behind} steps behind"
        unused = self.listeners.transcript.unused
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
        """End the files and the processes beside."""
        if not self._begun:
            return
        self.capture.close()
        self._guesses.close()
        for process in self.beside:
            process.close()
        self._complaints.report_held_back(last=True)


def _starts_before(run_dir: Path) -> int:
    """How often a tap was started in this folder before, as far as its status tells."""
    try:
        return int(from_json((run_dir / TAP_STATUS).read_bytes())["starts"])
    except (OSError, ValueError, LookupError, TypeError):
        return 0
