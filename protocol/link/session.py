"""Exactly once over a network that loses, repeats, delays and reorders, with processes that die.

Both ends are sans I/O: what was heard goes in, effects come out, and nothing is sent before it is
saved. The controller's is ``controller_service/core.py``, the plant's ``plant_service/core.py``.
Here is what they share. The rules are those of docs/protocol.md, numbered there and here:

1. The plant owns the step counter k and repeats Measurement(k) until Offer(k) or its deadline.
2. The controller counts a transition when a measurement first reports it, and answers the same
   measurement with the same offer, byte for byte except copy_number and nonce.
3. The cipher symbol of a transition is decided once, when the one before it is counted; it is sent
   again, unchanged, in every offer until one of them has been applied.
4. A missed step is no transition: it is never tested and moves no automaton.
5. The plant takes an offer for its session and its current k only, once.
6. A session has a random id made by the plant, for the one controller that it asks to take it up;
   another process may go on with it only from the journal that it was kept in. A side whose journal
   is gone or does not fit makes it end: the half-agreed key is dropped and the message starts again
   from its last whole frame.
7. Messages are framed and queue up in order.
8. Where keys are made, the first copy of a step's message, copy 0, carries a nonce that was saved
   before, and leaves at most once. All others are copies 1 with a dummy; so is whatever a process
   sends for the step it woke up in.
9. CountedTransition j contributes the offer's nonce if ``applied_copy`` is 0, and the nonce of the
   measurement that the offer answers if its ``heard`` is 0.
10. The session's first transition fixes where block 0 begins; block b is the next N_b transitions.

What holds under every schedule: what the plant has recovered is a prefix of what was sent; both
automata agree on every transition both have counted; no key symbol serves two message symbols.
"""

import base64
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple, Self

from protocol.agreement import (
    INSIDE,
    NO_SYMBOL,
    AgreementResult,
    AgreementRule,
    Gauge,
    predict,
)
from protocol.box_observer import Box, Estimate
from protocol.defence.alarm_rule import AT_ONCE, AlarmRule
from protocol.defence.watch import UNWATCHED, Watch
from protocol.link.fallback import Fallback
from protocol.link.outputs import OutputRule
from protocol.link.records import LinkRecord
from protocol.messages import Measurement, Offer, SendCommand
from protocol.scenario import Scenario
from protocol.schemes.base import Scheme, decrypt
from protocol.schemes.registry import make_scheme
from protocol.secret.blocks import Schedule
from protocol.secret.stream import NOWHERE, Position
from protocol.vectors import Vector

SILENCE_S: Final = 2.0
"""Seconds after which a partner that does not answer counts as away, and another may come in."""


class TrueStep(NamedTuple):
    """What a step really came to, where an attack or a noisy sensor says otherwise.

    Parameters
    ----------
    x_next : tuple of float, shape (n,)
        The true state after the step.
    u : tuple of float, shape (m,)
        The input that was really applied.
    failed : str
        Why the attack is over, in the step in which it failed.
    """

    x_next: Vector
    u: Vector
    failed: str = ""

    def fields(self) -> dict[str, Any]:
        """As fields of a trace's line."""
        told = {"true_x_next": self.x_next, "true_u": self.u}
        return told | {"attack_failed": self.failed} if self.failed else told


class CountedTransition(NamedTuple):
    """A transition as one side counted it: the public part, and what that side made of it.

    ``j`` is its number in the session. ``x``, ``candidates``, ``cipher`` and ``x_next`` are public.
    ``role`` is ``message`` where it carried a message symbol, else ``test``. ``gauges`` (of the
    ``verdict``) tell how far ``x_next`` lies from each prediction; 1 is the edge of D_c. ``symbol``
    is the key symbol agreed, ``key`` the one under which it carried, ``message_symbol`` the m[p]
    carried (each -1 where there is none). ``p`` counts message symbols up to here, ``s`` is the
    automaton's state afterwards. ``tested`` says whether the verdict counted. ``counts`` says which
    copies count for keys: 1 the offer's, 2 that of the measurement it answers, 3 both.
    ``predictions`` are the offer's, of an f_c that is not linear. Only the plant has ``coin``, its
    b_r, and ``u``, the input that was in force. Where it is attacked, ``true_x_next`` and
    ``true_u`` are the ``truth``, for whoever judges the run. ``digits`` is the position in the key
    stream that the offer names, None where it names none; ``served`` has the digits that served.
    ``after`` is the link that follows; its step, reading and nonce are the end's to set. Only the
    controller has ``expected``, the candidate that its own digit chose: -1 where the transition is
    unwatched. A frame that it completed is ``delivered`` (controller), ``recovered`` or ``refused``
    (plant).
    """

    session: str
    j: int
    k: int
    x: Vector
    candidates: tuple[Vector, ...]
    cipher: int
    x_next: Vector
    role: Literal["test", "message"]
    verdict: AgreementResult
    symbol: int
    key: int
    message_symbol: int
    p: int
    s: int
    tested: bool
    counts: int = 0
    predictions: tuple[Vector, ...] = ()
    digits: Position | None = None
    served: tuple[int, ...] = ()
    after: LinkRecord = LinkRecord()
    coin: int = NO_SYMBOL
    u: Vector = ()
    truth: TrueStep | None = None
    expected: int = NO_SYMBOL
    delivered: SendCommand | None = None
    recovered: bytes | None = None
    refused: bool = False

    @property
    def shared(self) -> Self:
        """What both ends count alike: all but coin, input, truth, test, and the message."""
        return self._replace(
            after=LinkRecord(),
            coin=NO_SYMBOL,
            u=(),
            truth=None,
            expected=NO_SYMBOL,
            delivered=None,
            recovered=None,
            refused=False,
        )

    def report(self) -> dict[str, Any] | None:
        """The line behind the transition's, of the frame that it completed, if any.

        ``delivered``: the controller has counted every symbol of it. ``recovered``: it passed its
        check at the plant. ``refused``: it failed.
        """
        if self.delivered is not None:
            payload = base64.b64encode(self.delivered.payload).decode()
            return {"event": "delivered", "id": self.delivered.id, "payload": payload}
        if self.recovered is not None:
            payload = base64.b64encode(self.recovered).decode()
            return {"event": "recovered", "payload": payload}
        if self.refused:
            return {"event": "refused", "session": self.session, "p": self.p}
        return None

    def as_event(self) -> dict[str, Any]:
        """The transition as a trace's event."""
        event = {
            "event": "transition",
            "session": self.session,
            "j": self.j,
            "k": self.k,
            "x": self.x,
            "candidates": self.candidates,
            "cipher": self.cipher,
            "x_next": self.x_next,
            "role": self.role,
            "gauges": self.verdict.gauges,
            "symbol": self.symbol,
            "key": self.key,
            "message_symbol": self.message_symbol,
            "p": self.p,
            "s": self.s,
            "counts": self.counts,
        }
        if self.predictions:
            event["predictions"] = self.predictions
        if self.verdict.box is not None:
            event["box"] = self.verdict.box
        if self.coin != NO_SYMBOL:
            event["coin"] = self.coin
            event["u"] = self.u
        if self.digits is not None:
            event["digits"] = self.digits
            event["keyed"] = bool(self.served)
        if self.expected != NO_SYMBOL:
            event["expected"] = self.expected
        return event if self.truth is None else event | self.truth.fields()


@dataclass(frozen=True, slots=True)
class Rules:
    """What both ends share: agreement rule, scheme, the plant's shape, and the fingerprint.

    Parameters
    ----------
    agreement : AgreementRule
    scheme : Scheme
    states, inputs : int
        Numbers of a reading, n where the whole state is read, and m.
    fingerprint : str
        Compared over the management bus before the first step.
    inputs_gauge : Gauge
        The gauge of U, the admissible inputs.
    schedule : Schedule, optional
        Of key blocks; without one no keys are made.
    predicted : bool
        f_c is not linear: its predictions travel with the offer.
    keyed : bool
        The plant's coin comes from the key stream, as long as it has digits.
    watch : Watch
        When unwatched steps make an alarm, where the coin is keyed.
    alarm_rule : AlarmRule
        When failed tests make an alarm.
    halts : bool
        An alarm ends the offers.
    outputs : OutputRule, optional
        In the place of ``agreement``, where some outputs alone are read.

    Attributes
    ----------
    digits : int
        Digits of the key stream that an offer takes: one for the coin, which is the first, and one
        for a sealed symbol.
    """

    agreement: AgreementRule
    scheme: Scheme[Any]
    states: int
    inputs: int
    fingerprint: str
    inputs_gauge: Gauge
    schedule: Schedule | None = None
    predicted: bool = False
    keyed: bool = False
    watch: Watch = UNWATCHED
    alarm_rule: AlarmRule = AT_ONCE
    halts: bool = False
    outputs: OutputRule | None = None
    digits: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digits", self.keyed + self.scheme.from_stream)

    @property
    def size(self) -> int:
        """M, the number of candidates and of symbols."""
        return self.scheme.alphabet

    def judge(
        self,
        x: Vector,
        candidates: tuple[Vector, ...],
        predictions: tuple[Vector, ...],
        x_next: Vector,
        box: Box | None = None,
    ) -> AgreementResult:
        """The verdict of a transition: on the offer's predictions, or on A x + B u.

        Where some outputs alone are read ``x`` and ``x_next`` are readings, and ``box`` is where
        the state lies.
        """
        if self.outputs is not None:
            assert box is not None
            return self.outputs.judge(box, candidates, x_next)
        if self.predicted:
            return self.agreement.verdict_at(predictions, x_next)
        return self.agreement.verdict(x, candidates, x_next)

    def count(
        self,
        before: LinkRecord,
        offer: Offer,
        x_next: Vector,
        digits: tuple[int, ...],
        coin: int = NO_SYMBOL,
    ) -> CountedTransition:
        """Judge the transition that an applied offer made of the link ``before``; advance.

        The key is what the test returns (equations 21 and 22), at both ends. Under the key stream
        it is the last of the ``digits`` that served. Where words are corrected the plant, which
        has a ``coin``, gathers that.
        """
        scheme, position = self.scheme, offer.position
        box = self.box(before.estimate, before.k - before.applied_k - 1, before.x)
        verdict = self.judge(before.x, offer.candidates, offer.predictions, x_next, box)
        state, symbol = before.state, verdict.symbol
        if scheme.corrects and coin != NO_SYMBOL:
            state, symbol = scheme.hear(state, offer.cipher), coin
        state, (agreed, pad) = scheme.follow(state, symbol)
        if scheme.from_stream and digits:
            pad = digits[-1]
        carried = pad != NO_SYMBOL
        after = before._replace(
            applied_k=offer.k,
            state=state,
            transitions=before.transitions + 1,
            p=before.p + carried,
            agreements=before.agreements + (agreed != NO_SYMBOL),
            estimate=verdict.estimate,
        )
        return CountedTransition(
            session=offer.session,
            j=before.transitions,
            k=offer.k,
            x=before.x,
            candidates=offer.candidates,
            cipher=offer.cipher,
            x_next=x_next,
            role="message" if carried else "test",
            verdict=verdict,
            symbol=agreed,
            key=pad,
            message_symbol=decrypt(offer.cipher, pad, self.size) if carried else NO_SYMBOL,
            p=after.p,
            s=after.s,
            tested=scheme.tests(before.state),
            predictions=offer.predictions,
            digits=None if position == NOWHERE else position,
            served=digits,
            after=after,
        )

    def box(self, estimate: Estimate | None, missed: int, reading: Vector) -> Box | None:
        """Where the state lies; None where it is read as it is.

        Parameters
        ----------
        estimate : Estimate, optional
            What the last transition left of its box.
        missed : int
            Steps since that transition.
        reading : tuple of float, shape (p,)
        """
        if self.outputs is None:
            return None
        return self.outputs.box(estimate, missed, reading)

    def prediction(self, t: CountedTransition, candidate: int) -> Vector:
        """f_c(x, u_i) of one candidate of a transition, as it would be read."""
        if self.outputs is not None:
            assert t.verdict.box is not None
            expected = self.outputs.predictions(t.verdict.box, t.candidates)[candidate]
            return self.outputs.observer.read(expected)
        if self.predicted:
            return t.predictions[candidate]
        return predict(self.agreement.A, self.agreement.B, t.x, t.candidates[candidate])

    def malformed_digits(self, name: str, *said: object) -> str:
        """What is wrong with a message's fields of the key stream, which begin with ``name``."""
        if not self.digits:
            none = all(v is None for v in said)
            return "" if none else f"{name}: expected none, as the key stream is not used"
        return f"{name}: expected one, as the key stream is used" if None in said else ""

    def malformed_predictions(self, predictions: tuple[Vector, ...]) -> str:
        """What is wrong with an offer's predictions; nothing where they are as the rules say."""
        if not self.predicted:
            return "offer.predictions: expected none, as f_c is linear" if predictions else ""
        if len(predictions) != self.size or any(len(c) != self.states for c in predictions):
            return f"offer.predictions: expected {self.size} predictions of {self.states} states"
        return ""

    def admissible(self, u: Vector) -> bool:
        """Whether ``u`` is in U, to rounding."""
        return self.inputs_gauge(u) <= INSIDE


@lru_cache(maxsize=16)
def rules_of(scenario: Scenario) -> Rules:
    """The rules that both ends of a scenario share."""
    D_c, noisy = scenario.defender.disturbance, scenario.defender.noise is not None
    H, h = scenario.test_set.rows()
    hers = scenario.secrecy.disturbance
    return Rules(
        agreement=AgreementRule(
            A=scenario.A,
            B=scenario.B,
            gauge=Gauge.from_rows(H, h),
            alpha=scenario.secrecy.alpha,
            reach=None if hers is None else Gauge.from_rows(*hers.rows()),
            apart=Gauge.from_rows(*D_c.rows()) if noisy else None,
            deviations=scenario.defender.deviations,
        ),
        scheme=make_scheme(scenario.secrecy.scheme, scenario.secrecy.candidates),
        states=scenario.readings,
        inputs=scenario.m,
        fingerprint=scenario.fingerprint(),
        inputs_gauge=Gauge.from_rows(*scenario.control.inputs.rows()),
        schedule=None if scenario.keys is None else scenario.keys.schedule(),
        predicted=scenario.defender.model is not None,
        keyed=scenario.defence.keyed,
        watch=scenario.watch,
        alarm_rule=scenario.alarm_rule,
        halts=scenario.defence.on_alarm == "safe",
        outputs=_output_rule(scenario),
    )


def _output_rule(scenario: Scenario) -> OutputRule | None:
    """The test on readings y = C x + n; None where the whole state is read."""
    observer = scenario.observer
    if observer is None:
        return None
    gauge = Gauge.from_rows(*scenario.defender.disturbance.rows())
    return OutputRule(observer, gauge, scenario.secrecy.alpha, Fallback.of(scenario))


def reports(link: LinkRecord, offer: Offer | None, measurement: Measurement) -> bool:
    """Whether a measurement reports that ``offer``, the controller's last one, was applied."""
    return offer is not None and measurement.applied_k != link.applied_k
