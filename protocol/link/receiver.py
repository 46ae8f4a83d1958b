"""The plant's end of the link, sans I/O; its rules are those of :mod:`protocol.link.session`."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.link.keying import Keying
from protocol.link.records import ReceiverRecord
from protocol.link.session import CountedTransition, Rules
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from protocol.schemes.base import decrypt
from protocol.schemes.framing import Deframer, Frame
from protocol.secret.blocks import BlockResult
from protocol.secret.nonces import Contribution, NonceSource, fresh_nonce
from protocol.vectors import Vector

CHUNK_SYMBOLS: Final = 64
"""Symbols of the frame under way that the record holds before they go to the journal's own table.
Within a chunk a save is one statement in every state of the scheme, so that none takes longer."""


def hex_digits(size: int) -> int:
    """Hexadecimal digits of a symbol kept: one up to M = 16, else two."""
    return 1 if size <= 16 else 2


class ReceiverEffects(NamedTuple):
    """What the plant's shell must save and trace after a transition.

    ``chunk`` has symbols of the frame under way that leave the record for the journal's own table;
    ``frame`` is a frame that ended, whose symbols the journal may drop. ``contribution`` is what
    the transition contributes to its key block, ``judged`` what the offer's word says of blocks.
    """

    transition: CountedTransition
    chunk: str = ""
    frame: Frame | None = None
    contribution: Contribution | None = None
    judged: tuple[BlockResult, ...] = ()


@dataclass(slots=True)
class _Acquaintance:
    """Which controller process was asked in this life, and what it has said."""

    controller: str | None = None
    accepted: bool = False


class Receiver:
    """The plant's end of the link.

    Parameters
    ----------
    rules : Rules
    instance : str
        Random id of this process.
    record : ReceiverRecord
        As read back from the journal, or a new session's.
    chunks : str
        Symbols of the frame under way that have left the record, as read back.
    raws : iterable of Raw
        Rows of key blocks that are not settled, as read back.
    said : Measurement, optional
        What was said after that record, as read back: its transition is to be counted first.
    fresh : NonceSource
    """

    def __init__(
        self,
        rules: Rules,
        instance: str,
        record: ReceiverRecord,
        chunks: str = "",
        contributions: Iterable[Contribution] = (),
        said: Measurement | None = None,
        fresh: NonceSource = fresh_nonce,
    ) -> None:
        self.rules = rules
        self.instance = instance
        self.record = record._replace(state=rules.scheme.restore(record.state), begun=None)
        self.deframer = Deframer(rules.size)
        self._covers = Deframer(rules.size)
        self._digits = hex_digits(rules.size)
        kept = chunks + record.partial
        for i in range(0, len(kept), self._digits):
            self.deframer.push(int(kept[i : i + self._digits], 16))
        self._met = _Acquaintance()
        self._anyone = not record.transitions
        self._known = record.transitions > 0 or record.sessions > 1
        self._refused = False
        self.keying = Keying(rules.schedule, fresh)
        self._report = said
        self._left = True  # copy 0 of the newest measurement may have left
        word = said or record
        self.keying.begin(record.session, word.block, word.tag, contributions)
        self.record = self.record._replace(tag=record.tag or self.keying.no_tag)

    @property
    def accepted(self) -> bool:
        """Whether the controller asked has accepted this session in this process's life."""
        return self._met.accepted

    @property
    def refused(self) -> bool:
        """Whether the only controller shares another model: there is nothing to go on with."""
        return self._refused

    @property
    def controller(self) -> str | None:
        """The controller process that was asked last in this process's life, if any."""
        return self._met.controller

    def hello(self) -> PlantHello:
        """Ask the controller to take up this session, or look for one."""
        return PlantHello(
            instance=self.instance,
            session=self.record.session,
            controller=None if self._anyone else self._met.controller,
            incarnation=self.record.incarnation,
            fingerprint=self.rules.fingerprint,
            transitions=self.record.transitions,
            applied_k=self.record.applied_k,
        )

    def look_around(self) -> None:
        """The controller has been silent for long: from here on any other will do."""
        self._anyone = True

    def heard_controller(
        self, hello: ControllerHello, new_session: str
    ) -> Literal["nothing", "greet", "accepted", "ended", "incompatible", "competing", "refused"]:
        """The controller spoke on ops; says what the shell must do next.

        ``greet``: save the record and answer with :meth:`hello`. ``ended``: a new session,
        ``new_session``, has begun; drop the journal's partial frame as well. ``competing``: a
        second controller; answer, so that it learns whose the session is. ``incompatible``: a
        controller of another model beside the one known, answer a greeting of it. ``refused``: the
        models differ.
        """
        record = self.record
        if hello.fingerprint != self.rules.fingerprint:
            if self._known:
                return "incompatible"
            self._refused = True
            return "refused"
        if hello.verdict == "greeting":
            return self._greeted(hello, new_session)
        if hello.answers != self.instance or hello.session != record.session:
            return "nothing"
        if hello.instance != self._met.controller:
            return "competing"
        self._anyone = False
        if hello.verdict == "accepted":
            self._met.accepted = self._known = True
            return "accepted"
        self._begin_session(new_session)
        self._met.accepted = False
        return "ended"

    def _greeted(
        self, hello: ControllerHello, new_session: str
    ) -> Literal["nothing", "greet", "ended", "competing"]:
        """A controller is there: ask it, unless the session is with another that may still live.

        From the journal that the session was kept in, the newest life counts and no other.
        """
        record = self.record
        asked = self._met.controller
        returned = hello.session == record.session
        over = returned and hello.incarnation < record.incarnation
        if over or not (hello.instance == asked or returned or self._anyone):
            return "nothing" if asked is None else "competing"
        self._anyone = False
        taken = record.controller not in ("", hello.instance)
        self.record = record._replace(controller=hello.instance, incarnation=hello.incarnation)
        if hello.instance == asked:
            return "greet"
        self._met = _Acquaintance(hello.instance)
        if taken and not returned and not record.transitions:
            self._begin_session(new_session)
            return "ended"
        return "greet"

    def measurement(self) -> Measurement:
        """Measurement(k): the state, the last applied offer and what came right after it.

        The first one of a step is its copy 0 and must leave; each one after it is another copy.
        """
        record = self.record
        again = (self._left or bool(self.keying.crowded)) and self.keying.on
        self._left = True
        return Measurement(
            session=record.session,
            k=record.k,
            x=record.x,
            applied_k=record.applied_k,
            x_after=record.x_after,
            copy_number=1 if again else 0,
            nonce=self.keying.nonce() if again else record.nonce,
            applied_copy=record.applied_copy,
            block=record.block,
            tag=record.tag,
        )

    def moved(self, offer: Offer, x_next: Vector) -> Measurement:
        """Measurement(k + 1), once ``offer`` has been applied and led to ``x_next``: its copy 0.

        It can be made, and sent, before :meth:`applied` has counted the transition; if it is sent,
        :meth:`reported` must be told. Made twice for one step it is the same.
        """
        record = self.record
        made = self._report
        if made is None or made.k != record.k + 1:
            block, tag = self.keying.word()
            made = self._report = Measurement(
                session=record.session,
                k=record.k + 1,
                x=x_next,
                applied_k=record.k,
                x_after=x_next,
                copy_number=self.keying.copy(),
                nonce=self.keying.nonce(),
                applied_copy=offer.copy_number,
                block=block,
                tag=tag,
            )
            self._left = False
        return made

    def reported(self) -> None:
        """What :meth:`moved` gave is on its way: whatever follows is another copy."""
        self._left = True

    def check(self, offer: Offer) -> Literal["current", "stale", "foreign"]:
        """Whether an offer is for this session and this step (rule 5).

        Raises
        ------
        ValueError
            When its shape is not the plant's, or a candidate is not admissible: malformed.
        """
        rules = self.rules
        if len(offer.candidates) != rules.size:
            raise ValueError(
                f"offer.candidates: got {len(offer.candidates)}, expected {rules.size}"
            )
        if any(len(u) != rules.inputs for u in offer.candidates):
            raise ValueError(f"offer.candidates: expected {rules.inputs} inputs in each")
        if not all(map(rules.admissible, offer.candidates)):
            raise ValueError("offer.candidates: expected inputs in U")
        if wrong := rules.malformed_predictions(offer.predictions):
            raise ValueError(wrong)
        if offer.cipher >= rules.size:
            raise ValueError(f"offer.cipher: got {offer.cipher}, expected below {rules.size}")
        if offer.session != self.record.session:
            return "foreign"
        return "current" if offer.k == self.record.k else "stale"

    def applied(self, offer: Offer, coin: int, x_next: Vector) -> ReceiverEffects:
        """Count the transition of the ``current`` offer, of which candidate ``coin`` was applied.

        The key is what the test returns, as for the controller; ``coin`` is only compared with it.
        A cover symbol is worked on as a message symbol is, and thrown away: what comes after a step
        delays the next one, and would show.
        """
        record = self.record
        report = self.moved(offer, x_next)
        self._anyone = False
        scheme = self.rules.scheme
        verdict = self.rules.judge(record.x, offer.candidates, offer.predictions, x_next)
        after, carry = scheme.follow(record.state, verdict.symbol)
        agreed, pad = carry
        symbol = decrypt(offer.cipher, pad, scheme.alphabet)
        carried = pad != NO_SYMBOL
        deframer = (self._covers, self.deframer)[carried]
        ended = deframer.push(symbol)
        kept, full = f"{record.partial}{symbol:0{self._digits}x}", ""
        if not deframer.symbols:
            kept = ""
        if len(kept) >= CHUNK_SYMBOLS * self._digits:
            kept, full = "", kept
        both = (NO_SYMBOL, None, record.partial, ""), (symbol, ended, kept, full)
        recovered, frame, partial, chunk = both[carried]
        steps = record.k - record.applied_k
        contribution = self.keying.count(
            record.transitions, steps, offer, offer.copy_number, record.nonce
        )
        transition = CountedTransition.of(
            scheme, record, offer, x_next, verdict, after, carry, recovered, contribution
        )
        self.record = record._replace(
            k=record.k + 1,
            x=x_next,
            u=offer.candidates[coin],
            applied_k=record.k,
            x_after=x_next,
            partial=partial,
            state=after,
            transitions=record.transitions + 1,
            p=transition.p,
            agreements=record.agreements + (1 if agreed != NO_SYMBOL else 0),
            symbol_errors=record.symbol_errors + (1 if agreed not in (NO_SYMBOL, coin) else 0),
            messages=record.messages + (1 if frame is not None and frame.intact else 0),
            frames_refused=record.frames_refused
            + (1 if frame is not None and not frame.intact else 0),
            nonce=report.nonce,
            applied_copy=report.applied_copy,
            block=report.block,
            tag=report.tag,
            blocks_begun=record.blocks_begun + (contribution is not None and self.keying.began),
        )
        return ReceiverEffects(transition, chunk, frame, contribution, self.keying.heard(offer))

    def missed(self, u: Vector, x_next: Vector) -> None:
        """No offer came in time: the fallback input ``u`` was applied (rule 4)."""
        record = self.record
        block, tag = self.keying.word()
        self.record = record._replace(
            k=record.k + 1,
            x=x_next,
            u=u,
            missed=record.missed + 1,
            nonce=self.keying.nonce(),
            block=block,
            tag=tag,
        )
        self._left = False

    def end_session(self, session: str) -> None:
        """The two ends hold different key blocks: begin anew, as ``session``."""
        self._begin_session(session)
        self._met.accepted = False

    def _begin_session(self, session: str) -> None:
        self.deframer.reset()
        self.record = self.record._replace(
            session=session,
            applied_k=-1,
            x_after=(),
            partial="",
            state=self.rules.scheme.initial,
            transitions=0,
            p=0,
            sessions=self.record.sessions + 1,
            nonce="",  # that of this step may have left
            applied_copy=0,
            block=-1,
            tag=self.keying.no_tag,
        )
        self._left = True
        self._report = None
        self.keying.begin(session)
