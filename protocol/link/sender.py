"""The controller's end of the link, sans I/O, by the rules of :mod:`protocol.link.session`."""

from collections.abc import Callable, Iterable
from typing import Final, Literal, NamedTuple, Protocol

from protocol.agreement import NO_SYMBOL, Verdict
from protocol.link.keying import Keying
from protocol.link.session import CountedTransition, Rules
from protocol.messages import LARGEST_COUNT, ControllerHello, Measurement, Offer, PlantHello
from protocol.schemes.base import Carry, encrypt
from protocol.schemes.framing import IDLE, encode_frame
from protocol.secret.blocks import Judgement
from protocol.secret.nonces import NonceSource, Raw, fresh_nonce
from protocol.streams import SymbolSource
from protocol.vectors import Vector

REMEMBERED_SESSIONS: Final = 16
"""Ended sessions a controller remembers, so that a delayed hello cannot bring one back."""


LARGEST: Final = 1e150
"""No number of a state is larger: sums and quotients of larger ones need not be finite."""

STALE: Final = 64
"""Measurements of steps gone by, without a newer one between, after which the plant is believed and
not the journal: a newest step that the plant never made was answered. A network that reorders holds
back fewer."""


Predict = Callable[[Vector, Vector], Vector]
"""A nonlinear f_c: (x, u) -> the predicted state; LookupError where it has none."""


class Outbox(Protocol):
    """The queue of messages to deliver, in order, numbered from 0."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""


class SenderRecord(NamedTuple):
    """All that the controller must not forget, as its journal keeps it.

    ``state`` is the scheme's. ``cipher`` is the decided symbol of the next transition and
    ``message_symbol`` the m[p] inside it (-1 in a cover); ``message`` and ``offset`` say where in
    which queued frame the next message symbol comes from, and ``framed`` whether the pending one
    came from there or is idle.
    ``offer`` is the one answer that may still be applied, ``nonce`` that of the measurement it
    answers, if its copy 0 came first; ``block`` and ``tag`` are the word on key blocks given last.
    ``life`` counts the processes that had this journal.
    """

    session: str | None = None
    ended: tuple[str, ...] = ()
    state: tuple[int, ...] = ()
    k: int = -1
    applied_k: int = -1
    transitions: int = 0
    agreements: int = 0
    p: int = 0
    cipher: int = 0
    message_symbol: int = NO_SYMBOL
    framed: bool = False
    message: int = 0
    offset: int = 0
    x: Vector = ()
    offer: Offer | None = None
    nonce: str = ""
    block: int = -1
    tag: str = ""
    life: int = 0

    @property
    def s(self) -> int:
        """What the automaton is doing, by number."""
        return self.state[0]


class Decision(NamedTuple):
    """The decided symbol of the next transition; the fields are those of :class:`SenderRecord`."""

    cipher: int
    message_symbol: int
    framed: bool
    offset: int


class Counted(NamedTuple):
    """What a measurement made of the transition it reports: verdict, state, the next symbol."""

    verdict: Verdict
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


class SenderEffects(NamedTuple):
    """What the controller's shell must do, in this order: trace, save, publish.

    ``save`` asks for the record; ``append`` for the measurement and the ``offer`` in answer, beside
    the record before them, and then for :meth:`Sender.settle`, once the offer is on its way.
    ``refusal`` is a line for the log; ``greet`` asks for a hello, because the plant speaks of a
    session that is not this process's. ``raw`` is what the transition contributes to its key block,
    ``judged`` what the measurement's word says of blocks.
    """

    save: bool = False
    append: bool = False
    transition: CountedTransition | None = None
    delivered: int | None = None
    offer: Offer | None = None
    reply: ControllerHello | None = None
    refusal: str = ""
    greet: bool = False
    raw: Raw | None = None
    judged: tuple[Judgement, ...] = ()


NOTHING: Final = SenderEffects()


def _after(life: int) -> int:
    return min(life + 1, LARGEST_COUNT)


class Sender:
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
        raws: Iterable[Raw] = (),
        nonces: NonceSource = fresh_nonce,
        predict: Predict | None = None,
    ) -> None:
        self.rules = rules
        record = record or SenderRecord()
        state = rules.scheme.restore(record.state)
        self.record = record._replace(state=state, life=_after(record.life))
        self.instance = instance
        self._propose = propose
        self._predict = predict
        self._outbox = outbox
        self._fresh = fresh
        self._plant: str | None = None
        self._elsewhere: str | None = None
        self._refused = False
        self._stale = 0
        self._frame: tuple[int, bytes] = (-1, b"")
        self.keying = Keying(rules.schedule, nonces)
        if self.record.session is not None:
            word = self.record if step is None else step[1]
            self.keying.begin(self.record.session, word.block, word.tag, raws)
        self._answer: Answer | None = None
        self._aim()
        if step is not None:
            measurement, offer = step
            self._answer = Answer(measurement, self._count(measurement, offer.cipher), offer)

    @property
    def plant(self) -> str | None:
        """The plant process whose session is taken up, if any."""
        return self._plant

    @property
    def carries(self) -> bool:
        """Whether the transition to come carries a message symbol."""
        return self.rules.scheme.pad(self.record.state) != NO_SYMBOL

    @property
    def refused(self) -> bool:
        """Whether the only plant there shares another model: there is nothing to go on with."""
        return self._refused

    def greeting(self) -> ControllerHello:
        """The first word after a start: asks the plant to say which session it is in.

        The record must have been saved before: no other process may greet as this life.
        """
        return self._hello("greeting")

    def heard_plant(self, hello: PlantHello, *, running: bool = False) -> SenderEffects:
        """The plant asks to take up a session (rule 6).

        ``running`` says that the plant whose session is taken up was heard just now: another one
        then has to wait.
        """
        record = self.record
        if hello.fingerprint != self.rules.fingerprint:
            self._refused = record.session is None and not record.ended
            return SenderEffects(
                reply=self._hello("other-model", hello),
                refusal=f"plant {hello.instance} shares another model",
            )
        ours = hello.session == record.session
        if running and not ours and self._plant not in (None, hello.instance):
            return SenderEffects(
                refusal=f"plant {hello.instance} speaks up while plant {self._plant} runs: "
                "two plants on one loop?"
            )
        if hello.controller is None:
            self._elsewhere = None
            behind = ours and hello.life > record.life
            if behind:  # the plant knows lives of this journal which it does not know itself
                self.record = record._replace(life=_after(hello.life))
            return SenderEffects(save=behind, reply=self.greeting())
        asked = hello.controller == self.instance
        late = ours and hello.applied_k < record.applied_k
        if late and (hello.instance == self._plant or not asked):
            return NOTHING  # it was overtaken
        if not asked and ours and hello.life < record.life:
            self._elsewhere = None
            return SenderEffects(greet=True)  # it asks a former life of this controller
        if not asked:
            return self._step_back(hello)
        self._elsewhere = None
        if ours:
            outstanding = record.offer.k if record.offer is not None else record.applied_k
            if hello.applied_k in (record.applied_k, outstanding):
                self._plant = hello.instance
                return SenderEffects(reply=self._hello("accepted", hello))
            return self._refuse(hello, "the journals do not fit together")
        if hello.transitions or hello.session in record.ended:
            return self._refuse(hello, "the plant is in a session this journal does not know")
        self._adopt(hello)
        return SenderEffects(save=True, reply=self._hello("accepted", hello))

    def measured(self, measurement: Measurement) -> SenderEffects:
        """A measurement arrived: count what it reports, decide, offer (rules 2 and 3).

        With ``append`` among the effects, what the offer hangs on is done and the rest is left to
        :meth:`settle`, which must come before the next event.

        Raises
        ------
        ValueError
            When its vectors do not have the plant's dimension, or are too large to reckon with:
            garbage; nothing has changed.
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
        if max(map(abs, measurement.x + measurement.x_after)) > LARGEST:
            raise ValueError(f"measurement: got a state beyond {LARGEST:g}")
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
            centres = self._centres(measurement.x, candidates)
        except LookupError as error:
            self._answer = Answer(measurement, counted, None)
            return self.settle()._replace(save=True, refusal=str(error))
        block, tag = self.keying.word()
        offer = Offer(
            session=measurement.session,
            k=measurement.k,
            candidates=candidates,
            centres=centres,
            cipher=record.cipher if counted is None else counted.following.cipher,
            nonce=self.keying.nonce(),
            heard=measurement.copy_number,
            block=block,
            tag=tag,
        )
        self._answer = Answer(measurement, counted, offer)
        return SenderEffects(append=True, offer=offer)

    def _centres(self, x: Vector, candidates: tuple[Vector, ...]) -> tuple[Vector, ...]:
        """f_c(x, u_i) where f_c is not linear; raises LookupError where it has no answer."""
        if not self.rules.predicted:
            return ()
        assert self._predict is not None, "a nonlinear f_c is the controller's to bring"
        return tuple([self._predict(x, u) for u in candidates])

    @property
    def unsettled(self) -> bool:
        """Whether an answer, given now or read back from the journal, waits for `settle`."""
        return self._answer is not None

    def settle(self) -> SenderEffects:
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
        agreed, pad = counted.carry
        applied = before.offer
        assert applied is not None
        carried = pad != NO_SYMBOL
        p = before.p + (1 if carried else 0)
        raw = self.keying.count(
            before.transitions,
            applied.k - before.applied_k,
            applied,
            measurement.applied_copy,
            before.nonce,
        )
        transition = CountedTransition(
            session=applied.session,
            j=before.transitions,
            k=applied.k,
            x=before.x,
            candidates=applied.candidates,
            cipher=applied.cipher,
            x_next=measurement.x_after,
            role="message" if carried else "test",
            verdict=counted.verdict,
            symbol=agreed,
            key=pad,
            message_symbol=before.message_symbol,
            p=p,
            s=counted.after[0],
            tested=self.rules.scheme.tests(before.state),
            counts=0 if raw is None else raw.counts,
            centres=applied.centres,
        )
        self.record = said._replace(
            state=counted.after,
            k=measurement.k,
            applied_k=applied.k,
            transitions=before.transitions + 1,
            agreements=before.agreements + (1 if agreed != NO_SYMBOL else 0),
            p=p,
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
            raw=raw,
            judged=judged,
        )

    def unequal(self) -> SenderEffects:
        """The two ends hold different key blocks: end the session."""
        self._drop_session()
        return SenderEffects(
            save=True, greet=True, refusal="a key block differs from the plant's; session ended"
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
        verdict = self.rules.judge(record.x, offer.candidates, offer.centres, measurement.x_after)
        after, carry = self._arrows[verdict.symbol]
        delivered = None
        message, offset = record.message, record.offset
        whole = offset == len(self._symbols(message))  # looked at in every state, as in `_decide`
        if whole and record.framed:
            delivered = message
            message, offset = message + 1, 0
        following = self._decide(after, record.transitions + 1, message, offset, decided)
        return Counted(verdict, after, carry, message, delivered, following)

    def _decide(
        self,
        state: tuple[int, ...],
        transitions: int,
        message: int,
        offset: int,
        decided: int | None = None,
    ) -> Decision:
        """Decide the cipher symbol of the transition to come: once, and never again (rule 3).

        Both decisions are made in both states, and one is taken, so that neither takes longer.
        """
        fresh = self._fresh.symbol(transitions, self.rules.size) if decided is None else decided
        symbols = self._symbols(message)
        framed = bool(symbols)
        message_symbol = symbols[offset] if framed else IDLE
        pad = self.rules.scheme.pad(state)
        cipher = encrypt(message_symbol, pad, self.rules.size)
        both = (
            Decision(cipher, message_symbol, framed, offset + framed),
            Decision(fresh, NO_SYMBOL, False, offset),
        )
        return both[pad == NO_SYMBOL]

    def _aim(self) -> None:
        """Have the arrows from the present state at hand, once a message is on its way.

        Those of a rare state would else be looked for, far from the processor, before the next one.
        """
        verdicts = (*range(self.rules.size), NO_SYMBOL)
        self._arrows = [self.rules.scheme.follow(self.record.state, v) for v in verdicts]

    def _symbols(self, message: int) -> bytes:
        """The frame of a queued message, or nothing while there is none."""
        number, symbols = self._frame
        if number != message:
            payload = self._outbox.payload(message)
            if payload is None:
                return b""
            symbols = encode_frame(payload, self.rules.size)
            self._frame = (message, symbols)
        return symbols

    def _adopt(self, hello: PlantHello) -> None:
        """Begin a session; the frame under way starts again."""
        fresh = SenderRecord(
            session=hello.session,
            state=self.rules.scheme.initial,
            ended=self._ended_now(),
            message=self.record.message,
            k=-1,
            life=self.record.life,
        )
        first = self._decide(fresh.state, 0, fresh.message, 0)
        self.record = fresh._replace(cipher=first.cipher)
        self._aim()
        self.keying.begin(hello.session)
        self._plant = hello.instance
        self._stale = 0

    def _ended_now(self) -> tuple[str, ...]:
        if self.record.session is None:
            return self.record.ended
        return (*self.record.ended, self.record.session)[-REMEMBERED_SESSIONS:]

    def _drop_session(self) -> bool:
        """Forget the session and its half-agreed key; False when there is none to forget."""
        self._plant = None
        self._stale = 0
        if self.record.session is None:
            return False
        self.record = SenderRecord(
            ended=self._ended_now(),
            state=self.rules.scheme.initial,
            message=self.record.message,
            life=self.record.life,
        )
        self._aim()
        self.keying.end()
        return True

    def _refuse(self, hello: PlantHello, why: str) -> SenderEffects:
        """Have the plant begin another session; the one here is over once it does.

        Whoever asks may be gone for long: its hello may come late, and end nothing.
        """
        return SenderEffects(reply=self._hello("unknown-session", hello), refusal=why)

    def _step_back(self, hello: PlantHello) -> SenderEffects:
        """The plant asks another controller, or is with one: offer nothing in that session.

        Who worked in that very session until now drops it: the other one has its journal.
        """
        overtaken = self._plant is not None and hello.session == self.record.session
        if overtaken:
            self._drop_session()
        self._plant = None
        self._elsewhere = hello.session
        return SenderEffects(
            save=overtaken,
            refusal=f"plant {hello.instance} is with controller {hello.controller}, and not with "
            f"this one, {self.instance}",
        )

    def _diverged(self, measurement: Measurement) -> SenderEffects:
        """The plant reports what this journal rules out: one of the two went back in time."""
        self._drop_session()
        return SenderEffects(
            save=True,
            greet=True,
            refusal=f"measurement {measurement.k} does not follow from the journal; session ended",
        )

    def _hello(
        self,
        verdict: Literal["greeting", "accepted", "unknown-session", "other-model"],
        hello: PlantHello | None = None,
    ) -> ControllerHello:
        return ControllerHello(
            instance=self.instance,
            life=self.record.life,
            fingerprint=self.rules.fingerprint,
            verdict=verdict,
            session=hello.session if hello else self.record.session,
            answers=hello.instance if hello else None,
        )
