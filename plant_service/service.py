"""The plant's shell: clock, buses, journal and trace around :class:`plant_service.plant.Plant`."""

import base64
import queue
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from plant_service.plant import Move, Plant, first_record
from plant_service.status import News
from protocol.link.pacing import LOCKSTEP_REPEAT_S, Pacing
from protocol.link.session import SILENCE_S
from protocol.messages import (
    ControllerHello,
    Measurement,
    Offer,
    PlantHello,
    PlantStatus,
)
from protocol.runtime.inbox import Inbox
from protocol.runtime.journal import JournalError, PlantJournal
from protocol.runtime.process import (
    DONE,
    USAGE,
    Complaints,
    Pace,
    Throttle,
    UsageError,
    give_way,
    logger,
    new_id,
    spoken,
)
from protocol.runtime.run_folder import PLANT_JOURNAL, PLANT_STATUS, PLANT_TRACE, write_atomically
from protocol.runtime.trace import TraceWriter
from protocol.runtime.zenoh_bus import Bus
from protocol.scenario import Scenario
from protocol.schemes.framing import readable
from protocol.streams import COIN, noise, symbols
from protocol.topics import key_of

HELLO_S: Final = 0.1
"""Seconds between hellos until the controller answers."""

LOOK_S: Final = 0.1
"""Longest wait before the loop looks at its signals again."""

STATUS_S: Final = 0.05
HEALTH_S: Final = 1.0
LAST_WORD_S: Final = 1.0
"""Seconds to wait at the end for the controller to count the last transition."""


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """What the plant service is started with.

    ``steps`` ends it when k reaches that number; ``seed`` is for experiments only.
    """

    scenario: Scenario
    run_dir: Path
    loop: str
    pace: Pace
    steps: int | None = None
    seed: int | None = None


class PlantService:
    """Runs the plant until it is told to stop, or has made its steps.

    Parameters
    ----------
    config : PlantConfig
    field, ops : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    """

    def __init__(
        self, config: PlantConfig, field: Bus, ops: Bus, stopping: threading.Event
    ) -> None:
        scenario = config.scenario
        self._config = config
        self._stopping = stopping
        self._log = logger("plant")
        self._garbage = Complaints(self._log)
        self._strangers = Complaints(self._log)
        try:
            self._journal = PlantJournal(config.run_dir / PLANT_JOURNAL, scenario.fingerprint())
            record = self._journal.load()
            step = self._journal.step()
        except JournalError as error:
            raise UsageError(str(error)) from None
        self._trace = TraceWriter(config.run_dir / PLANT_TRACE, "plant", scenario.identity())
        resumed = record is not None
        if record is None:
            record = first_record(scenario, new_id())
            self._journal.save(record)
        self._trace.write(
            {
                "event": "session",
                "session": record.session,
                "reason": "resumed from the journal" if resumed else "new journal",
            }
        )
        self._latest_late_k = -1
        self.plant = Plant(
            scenario,
            new_id(),
            symbols(config.seed, COIN),
            noise(config.seed, scenario.n),
            record,
            self._journal.chunks(),
        )
        self._news = News(scenario, config.pace.text, seeded=config.seed is not None)
        for payload in self._journal.inbox(1):
            self._news.last_message = readable(payload)
        self._status_due = Throttle(STATUS_S)
        self._health_due = Throttle(HEALTH_S)
        self._hello_due = Throttle(HELLO_S)
        self._answered_at = time.monotonic()
        self._taken_up = ("", "")
        self._queue: Inbox[tuple[str, bytes]] = Inbox()
        loop = config.loop
        self._offer_key = key_of(Offer, loop)
        self._measurement = field.publisher(key_of(Measurement, loop))
        self._hello = ops.publisher(key_of(PlantHello, loop))
        self._status = ops.publisher(key_of(PlantStatus, loop))
        if step is not None:
            self._count(Move(step.offer, step.coin, step.measurement.x))
        self._started = self.plant.receiver.record.k > 0
        self._pacing = Pacing(
            config.pace.step_s(scenario.plant.period_s),
            scenario.link.repeats_per_period,
            time.monotonic(),
        )
        field.subscribe(self._offer_key, self._arrived)
        ops.subscribe(key_of(ControllerHello, loop), self._arrived)
        if config.seed is not None:
            self._log.warning("seed %d: symbols are predictable, for experiments only", config.seed)
        self._log.info(
            "session %s, model %s, step %d, pace %s",
            record.session,
            spoken(scenario.fingerprint()),
            self.plant.receiver.record.k,
            config.pace.text,
        )

    def _arrived(self, key: str, payload: bytes, _t_ns: int) -> None:
        self._queue.put((key, payload))

    # --- the loop ---------------------------------------------------------------------------------

    def run(self) -> int:
        """Step until stopped; returns the exit code."""
        try:
            code = self._run()
        finally:
            self._close()
        return code

    def _close(self) -> None:
        try:
            self._publish_status(force=True)
        except OSError as error:
            self._log.warning("the last status is lost: %s", error)
        finally:
            self._trace.close()
            self._journal.close()

    def _run(self) -> int:
        receiver = self.plant.receiver
        pacing = self._pacing
        while not self._stopping.is_set():
            now = time.monotonic()
            self._housekeeping(now)
            if receiver.refused:
                return USAGE
            if self._finished():
                return self._last_word()
            if pacing.tick(now, running=self._started or receiver.accepted) == "missed":
                self._miss()
            if receiver.accepted and pacing.measurement_due(now):
                self._measurement.put(receiver.measurement().wire())
            longest_s = LOOK_S if receiver.accepted else HELLO_S
            wait_s = pacing.wait_s(now, measuring=receiver.accepted, longest_s=longest_s)
            try:
                key, payload = self._queue.get(timeout=wait_s)
            except queue.Empty:
                continue
            if key == self._offer_key:
                self._take(payload)
            else:
                self._heard(payload)
        return DONE

    def _finished(self) -> bool:
        steps = self._config.steps
        return steps is not None and self.plant.receiver.record.k >= steps

    def _last_word(self) -> int:
        """Report the last transition until the controller has answered, or a second has passed."""
        until = time.monotonic() + LAST_WORD_S
        measurement = self.plant.receiver.measurement()
        payload = measurement.wire()
        while not self._stopping.is_set() and time.monotonic() < until:
            self._measurement.put(payload)
            try:
                key, answer = self._queue.get(timeout=LOCKSTEP_REPEAT_S)
            except queue.Empty:
                continue
            try:
                if key == self._offer_key and Offer.model_validate_json(answer).k == measurement.k:
                    break
            except ValidationError as error:
                self._garbage.add(f"offer: {error.error_count()} fields not as expected; ignored")
        return DONE

    # --- events -----------------------------------------------------------------------------------

    def _take(self, payload: bytes) -> None:
        """An offer arrived: if it is for this step, apply it, save, report, and only then count.

        The controller works on the report while the step is counted here.
        """
        receiver = self.plant.receiver
        try:
            offer = Offer.model_validate_json(payload)
            what = receiver.check(offer)
        except ValidationError as error:
            self._garbage.add(f"offer: {error.error_count()} fields not as expected; ignored")
            return
        except ValueError as error:
            self._garbage.add(f"{error}; ignored")
            return
        if what != "foreign":
            self._answered_at = time.monotonic()
        record = receiver.record
        if what == "stale" and max(record.applied_k, self._latest_late_k) < offer.k < record.k:
            # Its step was missed. (An answer to a repeated measurement, whose step was made, is
            # not late; nor is it late twice.)
            self._latest_late_k = offer.k
            self._news.late += 1
        if what != "current" or self._pacing.waiting:
            return
        move = self.plant.move(offer)
        report = receiver.moved(move.x_next).wire()
        self._journal.append(payload, report, move.coin)
        self._pacing.applied()
        if receiver.accepted and self._pacing.measurement_due(time.monotonic()):
            self._measurement.put(report)
            give_way()
        self._started = True
        self._count(move)

    def _count(self, move: Move) -> None:
        """Count, trace and keep what ``move`` made of the link; it is in the journal already."""
        step = self.plant.count(move)
        assert step.effects is not None
        effects = step.effects
        event = effects.transition.as_event()
        event["coin"] = step.coin
        event["u"] = step.u
        self._trace.write(event)
        record, frame = self.plant.receiver.record, effects.frame
        if effects.chunk or frame is not None:
            self._journal.save(
                record,
                chunk=effects.chunk,
                drop_chunks=frame is not None,
                received=frame.payload if frame is not None and frame.intact else None,
            )
        else:
            self._journal.stage(record)
        self._news.tail.append(step)
        if frame is not None:
            self._frame_ended(frame.payload, frame.intact, effects.transition.k)

    def _frame_ended(self, payload: bytes, intact: bool, k: int) -> None:
        if not intact:
            self._trace.write(
                {
                    "event": "refused",
                    "session": self.plant.receiver.record.session,
                    "p": self.plant.receiver.record.p,
                }
            )
            self._log.error("a frame failed its check and was refused")
            return
        self._trace.write({"event": "recovered", "payload": base64.b64encode(payload).decode()})
        self._news.last_message = readable(payload)
        self._news.message_k = k
        self._log.info("message recovered at step %d: %d bytes", k, len(payload))
        self._publish_status(force=True)

    def _miss(self) -> None:
        step = self.plant.miss()
        record = self.plant.receiver.record
        self._trace.write(
            {
                "event": "missed",
                "session": record.session,
                "k": step.k,
                "x": step.x,
                "u": step.u,
                "x_next": step.x_next,
            }
        )
        self._journal.save(record)
        self._started = True

    def _heard(self, payload: bytes) -> None:
        """The controller spoke on ops."""
        try:
            hello = ControllerHello.model_validate_json(payload)
        except ValidationError as error:
            self._garbage.add(f"hello: {error.error_count()} fields not as expected; ignored")
            return
        receiver = self.plant.receiver
        outcome = receiver.heard_controller(hello, new_id())
        if hello.instance == receiver.controller:
            self._answered_at = time.monotonic()
        if outcome == "refused":
            self._news.phase = "refused"
            self._news.detail = (
                f"the controller's model is {spoken(hello.fingerprint)}, "
                f"this plant's is {spoken(receiver.rules.fingerprint)}"
            )
            self._log.error("%s: the two ends must share one scenario", self._news.detail)
        elif outcome == "stranger":
            self._strangers.add(
                f"controller {hello.instance} has another model, "
                f"{spoken(hello.fingerprint)}; ignored"
            )
        elif outcome == "rival":
            self._strangers.add(
                f"controller {hello.instance} speaks up while controller {receiver.controller} has "
                f"the session: two controllers on loop {self._config.loop}?"
            )
        elif outcome == "accepted":
            self._news.phase = "running"
            taken_up = (hello.instance, receiver.record.session)
            if taken_up != self._taken_up:
                self._taken_up = taken_up
                self._log.info("controller %s took up session %s", *taken_up)
        elif outcome == "ended":
            self._news.phase = "greeting"
            self._trace.write(
                {
                    "event": "session",
                    "session": receiver.record.session,
                    "reason": "the controller does not know the session before",
                }
            )
            self._journal.save(receiver.record, drop_chunks=True)
            self._log.warning("session ended; new session %s", receiver.record.session)
        elif outcome == "greet":
            self._journal.save(receiver.record)
        greeted = outcome == "stranger" and hello.verdict == "greeting"
        if outcome in ("greet", "ended", "rival") or greeted:
            self._say_hello()

    def _say_hello(self) -> None:
        self._hello.put(self.plant.receiver.hello().wire())

    # --- telling ----------------------------------------------------------------------------------

    def _housekeeping(self, now: float) -> None:
        receiver = self.plant.receiver
        if self._pacing.waiting:
            self._answered_at = now
        silent = now - self._answered_at >= SILENCE_S
        if silent:
            receiver.look_around()
        if (silent or not receiver.accepted) and self._hello_due.ready(now):
            self._say_hello()
        if self._status_due.ready(now):
            self._publish_status()

    def _publish_status(self, *, force: bool = False) -> None:
        now = time.monotonic()
        if (force and self._stopping.is_set()) or self._finished():
            self._news.phase = "stopped" if self._news.phase != "refused" else self._news.phase
        payload = self.status(now).wire()
        self._status.put(payload)
        if force or self._health_due.ready(now):
            write_atomically(self._config.run_dir / PLANT_STATUS, payload)

    def status(self, now: float) -> PlantStatus:
        """What the dashboard is told."""
        return self._news.status(self.plant.receiver, self._garbage.total, now)


def run_plant(config: PlantConfig, field: Bus, ops: Bus, stopping: threading.Event) -> int:
    """Run the plant service on open buses; returns the exit code."""
    return PlantService(config, field, ops, stopping).run()
