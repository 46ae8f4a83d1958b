"""The controller's end of the link, sans I/O, by the rules of :mod:`protocol.link.session`."""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from protocol.agreement import NO_SYMBOL, AgreementResult
from protocol.link.ciphering import Ciphering, Decision, Outbox
from protocol.link.keying import Keying
from protocol.link.records import SenderRecord
from protocol.link.sender_session import NOTHING, SenderEffects, SenderSession
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Offer
from protocol.schemes.base import Carry
from protocol.secret.nonces import Contribution, NonceSource, fresh_nonce
from protocol.streams import SymbolSource
from protocol.vectors import Vector

LARGEST_STATE: Final = 1e150
"""No number of a state is larger: sums and quotients of larger ones need not be finite."""

STALE: Final = 64
"""Measurements of steps gone by, without a newer one between, after which the plant is believed and
not the journal: a newest step that the plant never made was answered. A network that reorders holds
back fewer."""


Predict = Callable[[Vector, Vector], Vector]
"""A nonlinear f_c: (x, u) -> the predicted state; LookupError where it has none."""


class Counted(NamedTuple):
    """What a measurement made of the transition it reports: verdict, state, the next symbol."""

    verdict: AgreementResult
    after: tuple[int, ...]
    carry: Carry
    message: int
    delivered: int | None
    following: Decision


class Answer(NamedTuple):
    """A measurement that moved the link on, what it counts, and the offer in answer if any."""

    measurement: Measurement
    counted: Counted | None
    offer: Offer | None


class Sender(SenderSession):
    """The controller's end of the link.

    Parameters
    ----------
    rules : Rules
    propose : callable
        x -> M candidate inputs; raises `LookupError` where the law has no answer.
    outbox : Outbox
    fresh : SymbolSource
        Random cipher symbols.
    instance : str
        Random id of this process.
    record : SenderRecord, optional
        As read back from the journal.
    step : tuple of Measurement and Offer, optional
        What was heard and said after that record, as read back: to be settled first.
    raws : iterable of Raw
        Rows of key blocks that are not settled, as read back.
    nonces : NonceSource
    predict : callable, optional
        f_c, where it is not linear.
    """

    def __init__(
        self,
        rules: Rules,
        propose: Callable[[Vector], tuple[Vector, ...]],
        outbox: Outbox,
        fresh: SymbolSource,
        instance: str,
        record: SenderRecord | None = None,
        step: tuple[Measurement, Offer] | None = None,
        contributions: Iterable[Contribution] = (),
        nonces: NonceSource = fresh_nonce,
        predict: Predict | None = None,
    ) -> None:
        super().__init__(
            rules,
            instance,
            record or SenderRecord(),
            Ciphering(rules.scheme, outbox, fresh),
            Keying(rules.schedule, nonces),
        )
        self._propose = propose
        self._predict = predict
        self._stale = 0
        if self.record.session is not None:
            word = self.record if step is None else step[1]
            self.keying.begin(self.record.session, word.block, word.tag, contributions)
        self._answer: Answer | None = None
        self._aim()
        if step is not None:
            measurement, offer = step
            self._answer = Answer(measurement, self._count(measurement, offer.cipher), offer)

    @property
    def carries(self) -> bool:
        """Whether the transition to come carries a message symbol."""
        return self.rules.scheme.pad(self.record.state) != NO_SYMBOL

    def measured(self, measurement: Measurement) -> SenderEffects:
        """A measurement arrived: count what it reports, decide, offer (rules 2 and 3).

        With ``append`` among the effects, what the offer hangs on is done and the rest is left to
        :meth:`finish_step`, which must come before the next event.

        Raises
        ------
        ValueError
            When its vectors do not have the plant's dimension, or are too large to reckon with:
            malformed; nothing has changed.
        """
        assert self._answer is None, "the answer before has not been settled"
        record = self.record
        n = self.rules.states
        if len(measurement.x) != n:
            raise ValueError(f"measurement.x: got {len(measurement.x)} states, expected {n}")
        if len(measurement.x_after) not in (0, n):
            raise ValueError(
                f"measurement.x_after: got {len(measurement.x_after)} states, expected {n} or none"
            )
        if max(map(abs, measurement.x + measurement.x_after)) > LARGEST_STATE:
            raise ValueError(f"measurement: got a state beyond {LARGEST_STATE:g}")
        if self._plant is None or measurement.session != record.session:
            return SenderEffects(greet=measurement.session != self._elsewhere)
        if measurement.k < record.k:
            self._stale += 1
            return NOTHING if self._stale < STALE else self._diverged(measurement)
        self._stale = 0
        offer = record.offer
        if offer is not None and measurement.k == offer.k:
            if measurement.applied_k == record.applied_k and measurement.x == record.x:
                return SenderEffects(offer=self.keying.again(offer))
            return self._diverged(measurement)
        counted = None
        if measurement.applied_k != record.applied_k:
            if offer is None or measurement.applied_k != offer.k or not measurement.x_after:
                return self._diverged(measurement)
            counted = self._count(measurement)
        try:
            candidates = self._propose(measurement.x)
            predictions = self._predictions(measurement.x, candidates)
        except LookupError as error:
            self._answer = Answer(measurement, counted, None)
            return self.finish_step()._replace(save=True, refusal=str(error))
        block, tag = self.keying.word()
        offer = Offer(
            session=measurement.session,
            k=measurement.k,
            candidates=candidates,
            predictions=predictions,
            cipher=record.cipher if counted is None else counted.following.cipher,
            copy_number=self.keying.copy(),
            nonce=self.keying.nonce(),
            heard=measurement.copy_number,
            block=block,
            tag=tag,
        )
        self._answer = Answer(measurement, counted, offer)
        return SenderEffects(append=True, offer=offer)

    def _predictions(self, x: Vector, candidates: tuple[Vector, ...]) -> tuple[Vector, ...]:
        """f_c(x, u_i) where f_c is not linear; raises LookupError where it has no answer."""
        if not self.rules.predicted:
            return ()
        assert self._predict is not None, "a nonlinear f_c is the controller's to bring"
        return tuple([self._predict(x, u) for u in candidates])

    @property
    def unfinished(self) -> bool:
        """Whether an answer, given now or read back from the journal, waits for `finish_step`."""
        return self._answer is not None

    def finish_step(self) -> SenderEffects:
        """Bring the record up to the answer given: the transition it counted, if any."""
        assert self._answer is not None, "there is no answer to settle"
        (measurement, counted, offer), self._answer = self._answer, None
        said = before = self.record
        if offer is not None:
            nonce = "" if measurement.copy_number else measurement.nonce
            said = before._replace(nonce=nonce, block=offer.block, tag=offer.tag)
        judged = self.keying.heard(measurement)
        if counted is None:  # no transition: the state, and the arrows from it, stay
            self.record = said._replace(k=measurement.k, x=measurement.x, offer=offer)
            return SenderEffects(judged=judged)
        following = counted.following
        applied = before.offer
        assert applied is not None
        contribution = self.keying.count(
            before.transitions,
            applied.k - before.applied_k,
            applied,
            measurement.applied_copy,
            before.nonce,
        )
        transition = CountedTransition.of(
            self.rules.scheme,
            before,
            applied,
            measurement.x_after,
            counted.verdict,
            counted.after,
            counted.carry,
            before.message_symbol,
            contribution,
        )
        self.record = said._replace(
            state=counted.after,
            k=measurement.k,
            applied_k=applied.k,
            transitions=before.transitions + 1,
            agreements=before.agreements + (1 if transition.symbol != NO_SYMBOL else 0),
            p=transition.p,
            cipher=following.cipher,
            message_symbol=following.message_symbol,
            framed=following.framed,
            message=counted.message,
            offset=following.offset,
            x=measurement.x,
            offer=offer,
        )
        self._aim()
        return SenderEffects(
            save=counted.delivered is not None,
            transition=transition,
            delivered=counted.delivered,
            contribution=contribution,
            judged=judged,
        )

    def _count(self, measurement: Measurement, decided: int | None = None) -> Counted | None:
        """Advance over the offer that ``measurement`` reports as applied; decide the next symbol.

        None where it reports none that is new. ``decided`` is the cipher symbol of an answer that
        was given before.
        """
        record = self.record
        offer = record.offer
        if offer is None or measurement.applied_k == record.applied_k:
            return None
        verdict = self.rules.judge(
            record.x, offer.candidates, offer.predictions, measurement.x_after
        )
        after, carry = self._arrows[verdict.symbol]
        delivered = None
        message, offset = record.message, record.offset
        frame = self._ciphering.frame(message)  # looked at in every state, as in `decide`
        if offset == len(frame) and record.framed:
            delivered = message
            message, offset = message + 1, 0
        following = self._ciphering.decide(after, record.transitions + 1, message, offset, decided)
        return Counted(verdict, after, carry, message, delivered, following)

    def _aim(self) -> None:
        """Have the arrows from the present state at hand, once a message is on its way.

        Those of a rare state would else be looked for, far from the processor, before the next one.
        """
        verdicts = (*range(self.rules.size), NO_SYMBOL)
        self._arrows = [self.rules.scheme.follow(self.record.state, v) for v in verdicts]

    def _rewind(self) -> None:
        self._stale = 0
        self._aim()
