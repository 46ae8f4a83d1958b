"""A step of the controller: from a measurement to an offer, and to a counted transition.

A step goes as in Fig. 6 of the paper: a measurement comes, the transition that it reports is judged
and moves the automaton, the next cipher symbol is decided, and the offer is saved and published.
The rest of the counting waits until the offer is on its way.
"""

from collections.abc import Callable
from math import inf
from typing import Final, Literal, NamedTuple

from controller_service.alarms import Judged, alarm_of, first, tested
from controller_service.state import ControllerState
from controller_service.telemetry import ControllerTelemetry
from protocol.link.effects import Effects, Extract, Notice, Publish, Tell
from protocol.link.key_events import block_notices
from protocol.link.records import LinkRecord, OutgoingRecord
from protocol.link.session import CountedTransition, reports
from protocol.link.step import IDLE, Answered
from protocol.messages import Measurement, Offer, SendCommand
from protocol.secret.stream import NOWHERE
from protocol.vectors import Vector

LARGEST_STATE: Final = 1e150
"""Largest component of a state: sums and quotients of larger ones may be infinite."""

STALE: Final = 64
"""Old measurements in a row, counted once in :data:`STALE_S`, after which the session ends: the
journal is ahead of the plant, for it answered a step that the plant never made."""

STALE_S: Final = 0.04
"""Seconds in which any number of old measurements count once: a paused process or a replay brings
hundreds at once, and they say nothing of the journal. A plant repeats its own each 0.05 s."""

HALTED: Final = (
    "an alarm has ended the offers (look at the plant, then wyner controller --clear-alarm)"
)

Predict = Callable[[Vector, Vector], Vector]
"""A nonlinear f_c: (x, u) -> the predicted state; LookupError where it has none."""

Place = Literal["old", "repeated", "next", "diverged"]
"""Where a measurement stands: before the step answered last, of that step, after it, or nowhere:
the journal rules it out."""


class Reported(NamedTuple):
    """What follows from a measurement, but for what the answer adds.

    ``counted`` is None where no new transition is reported.
    """

    link: LinkRecord
    frame: OutgoingRecord
    test: Judged
    counted: CountedTransition | None = None


class Chooser:
    """Answers one plant's measurements, and counts its transitions.

    Parameters
    ----------
    state : ControllerState
    news : ControllerTelemetry
    propose : callable
        x -> M candidate inputs; raises `LookupError` where the law has no answer.
    predict : callable, optional
        f_c, where it is not linear.

    Attributes
    ----------
    stale_at : float
        When an old measurement counts again.
    """

    def __init__(
        self,
        state: ControllerState,
        news: ControllerTelemetry,
        propose: Callable[[Vector], tuple[Vector, ...]],
        predict: Predict | None,
    ) -> None:
        self.state, self.news = state, news
        self.stale_at = -inf
        self._stale = 0
        self._propose, self._predict = propose, predict

    # --- a measurement ----------------------------------------------------------------------------

    def wrong(self, measurement: Measurement) -> str:
        """What is wrong with a measurement's vectors; nothing where they are the plant's."""
        n = self.state.rules.states
        if len(measurement.x) != n:
            return f"measurement.x: got {len(measurement.x)} states, expected {n}"
        if len(measurement.x_after) not in (0, n):
            size = len(measurement.x_after)
            return f"measurement.x_after: got {size} states, expected {n} or none"
        if max(map(abs, measurement.x + measurement.x_after)) > LARGEST_STATE:
            return f"measurement: got a state beyond {LARGEST_STATE:g}"
        return self.state.rules.malformed_digits("measurement.keyed", measurement.keyed)

    def place(self, measurement: Measurement) -> Place:
        """Where a measurement of the session stands."""
        link, before = self.state.link, self.state.offer
        same = measurement.applied_k == link.applied_k
        if measurement.k < link.k:  # held back by the network, or replayed
            if self.state.now >= self.stale_at:
                self.stale_at = self.state.now + STALE_S
                self._stale += 1
            return "old" if self._stale < STALE else "diverged"
        self._stale = 0
        if before is not None and measurement.k == before.k:
            return "repeated" if same and measurement.x == link.x else "diverged"
        reports_it = before is not None and measurement.applied_k == before.k
        return "next" if same or (reports_it and measurement.x_after) else "diverged"

    def forget(self) -> None:
        """A session begins: no old measurement was seen in it."""
        self._stale = 0

    # --- judge, decide, offer ---------------------------------------------------------------------

    def answer(self, measurement: Measurement) -> Effects:
        """Judge what the next measurement reports, decide, offer (rules 2 and 3); then count."""
        state, rules = self.state, self.state.rules
        reported = self.report(measurement)
        halted = reported.test.record.halted
        if halted and state.alarms.halted:
            return
        proposed = HALTED if halted else self._proposed(measurement, reported.link)
        if isinstance(proposed, str):  # what the measurement reports counts all the same
            self.news.enter("alarmed" if halted else "outside")
            yield self.news.refusal(proposed)
            yield from self.count(measurement, None, reported)
            return
        candidates, predictions = proposed
        block, tag = state.keys.announcement()
        position = NOWHERE
        if rules.digits and not state.keys.record.refuted:  # the plant holds what is announced
            position = state.keys.stream.name(rules.digits, block)
        digits = state.digits(position)
        offer = Offer(
            session=measurement.session,
            k=measurement.k,
            candidates=candidates,
            predictions=predictions,
            cipher=state.frame.cipher(reported.frame, state.link, digits),
            copy_number=state.keys.copy(),
            nonce=state.keys.nonce(),
            heard=measurement.copy_number,
            block=block,
            tag=tag,
            stream_block=position.block if rules.digits else None,
            stream_at=position.at if rules.digits else None,
        )
        state.step = Answered(measurement, offer)
        self.news.enter("running", "")
        yield state.save()
        yield Publish(offer)
        yield from self.count(measurement, offer, reported)

    def report(self, measurement: Measurement, decided: int | None = None) -> Reported:
        """Judge the offer that ``measurement`` reports as applied; decide the next symbol.

        Where it reports no new transition, the symbol decided before stays. ``decided`` is the
        cipher symbol of an answer that was given before.
        """
        state, rules, offer = self.state, self.state.rules, self.state.offer
        link, frame = state.link, state.frame.record
        if link.k < 0:
            return Reported(link, frame, first(rules, state.alarms))
        if offer is None or not reports(link, offer, measurement):
            return Reported(link, frame, Judged(state.alarms))
        # The plant says whether they served.
        digits = state.digits(offer.position) if measurement.keyed else ()
        counted = rules.count(link, offer, measurement.x_after, digits)
        if digits or not rules.scheme.from_stream:  # else its symbol was not carried: once more
            frame = state.frame.following(counted.after, decided)
        return Reported(counted.after, frame, tested(rules, state.alarms, counted), counted)

    def _proposed(
        self, measurement: Measurement, link: LinkRecord
    ) -> tuple[tuple[Vector, ...], tuple[Vector, ...]] | str:
        """The law's candidates and, where f_c is not linear, its predictions; or why not."""
        rules, x = self.state.rules, measurement.x
        try:
            box = rules.box(link.estimate, measurement.k - measurement.applied_k - 1, x)
            if box is not None:
                x = box.centre
            candidates = self._propose(x)
            if not rules.predicted:
                return candidates, ()
            assert self._predict is not None, "a nonlinear f_c is the controller's to bring"
            return candidates, tuple([self._predict(x, u) for u in candidates])
        except LookupError as error:
            return str(error)

    # --- and then: count --------------------------------------------------------------------------

    def count(self, measurement: Measurement, offer: Offer | None, reported: Reported) -> Effects:
        """Bring the state up to the answer given: the transition that it reports, if any."""
        state, before, applied = self.state, self.state.link, self.state.offer
        frame, test, counted = reported.frame, reported.test, reported.counted
        state.step = IDLE
        state.keys.compare(measurement)
        transition = delivered = alarm = None
        if counted is not None:
            assert applied is not None
            number = state.frame.record.message
            if frame.message != number:
                payload = state.messages.payload(number)
                assert payload is not None
                delivered = SendCommand(id=state.messages.identifier(number), payload=payload)
            transition = counted._replace(
                counts=state.keys.count(before, applied, measurement.applied_copy),
                expected=test.expected,
                delivered=delivered,
            )
            self.news.counted(transition)
        if test.reason:
            alarm = alarm_of(state.rules, measurement, transition, test.reason)
            self.news.alarmed(alarm)
        nonce = before.nonce
        if offer is not None:
            nonce = "" if measurement.copy_number else measurement.nonce
        state.link = reported.link.at(measurement.k, measurement.x, nonce)
        state.offer, state.alarms = offer, test.record
        state.frame.record = frame
        if applied is not None and self.state.rules.digits:
            state.keys.used(applied.position, self.state.rules.digits)
        ended = state.keys.ended()
        yield from map(Tell, ended)
        if transition is not None:
            yield Tell(transition)
        if alarm is not None:
            yield Tell(alarm)
        if delivered is not None or offer is None:  # else the next step saves the record
            yield state.save(durable=delivered is not None)
        if state.keys.on:
            yield from map(Extract, state.keys.tasks())
        if delivered is not None:
            self.news.soon(state.now)
            yield Notice(f"message {delivered.id} delivered")
        if alarm is not None:
            yield Notice(alarm.sentence(), "error", "alarms")
        if ended:
            yield from block_notices(state.keys, ended)
