"""The plant's end of the link, sans I/O; its rules are those of :mod:`protocol.link.session`."""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.link.session import Rules, Transition
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from protocol.schemes.base import decrypt
from protocol.schemes.framing import Deframer, Frame
from protocol.vectors import Vector

CHUNK: Final = 64
"""Symbols of the frame under way that the record holds before they go to the journal's own table.
Within a chunk a save is one statement in every state of the scheme, so that none takes longer."""


def hex_digits(size: int) -> int:
    """Hexadecimal digits of a symbol kept: one up to M = 16, else two."""
    return 1 if size <= 16 else 2


class ReceiverRecord(NamedTuple):
    """All that the plant must not forget, as its journal keeps it.

    ``applied_k`` and ``x_after`` report the last applied offer and the plant right after it;
    ``u`` is the input in force, which the fallback may hold; ``partial`` has the newest symbols of
    the frame under way, :func:`hex_digits` of each. Counters run over all sessions but
    ``transitions`` and ``p``, which begin with the session. ``controller`` is the process that was
    asked last to take the session up.
    """

    session: str
    k: int
    x: Vector
    u: Vector
    applied_k: int = -1
    x_after: Vector = ()
    partial: str = ""
    state: tuple[int, ...] = ()
    transitions: int = 0
    p: int = 0
    sessions: int = 1
    agreements: int = 0
    symbol_errors: int = 0
    missed: int = 0
    messages: int = 0
    frames_refused: int = 0
    controller: str = ""

    @property
    def s(self) -> int:
        """What the automaton is doing, by number."""
        return self.state[0]


class ReceiverEffects(NamedTuple):
    """What the plant's shell must save and trace after a transition.

    ``chunk`` has symbols of the frame under way that leave the record for the journal's own table;
    ``frame`` is a frame that ended, whose symbols the journal may drop.
    """

    transition: Transition
    chunk: str = ""
    frame: Frame | None = None


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
    """

    def __init__(
        self, rules: Rules, instance: str, record: ReceiverRecord, chunks: str = ""
    ) -> None:
        self.rules = rules
        self.instance = instance
        self.record = record._replace(state=rules.scheme.restore(record.state))
        self.deframer = Deframer(rules.size)
        self._digits = hex_digits(rules.size)
        kept = chunks + record.partial
        for i in range(0, len(kept), self._digits):
            self.deframer.push(int(kept[i : i + self._digits], 16))
        self._met = _Acquaintance()
        self._anyone = not record.transitions
        self._known = record.transitions > 0 or record.sessions > 1
        self._refused = False

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
            fingerprint=self.rules.fingerprint,
            transitions=self.record.transitions,
            applied_k=self.record.applied_k,
        )

    def look_around(self) -> None:
        """The controller has been silent for long: from here on any other will do."""
        self._anyone = True

    def heard_controller(
        self, hello: ControllerHello, new_session: str
    ) -> Literal["nothing", "greet", "accepted", "ended", "stranger", "rival", "refused"]:
        """The controller spoke on ops; says what the shell must do next.

        ``greet``: save the record and answer with :meth:`hello`. ``ended``: a new session,
        ``new_session``, has begun; drop the journal's partial frame as well. ``rival``: a second
        controller; answer, so that it learns whose the session is. ``stranger``: a controller of
        another model beside the one known, answer a greeting of it. ``refused``: the models differ.
        """
        record = self.record
        if hello.fingerprint != self.rules.fingerprint:
            if self._known:
                return "stranger"
            self._refused = True
            return "refused"
        if hello.verdict == "greeting":
            return self._greeted(hello, new_session)
        if hello.answers != self.instance or hello.session != record.session:
            return "nothing"
        if hello.instance != self._met.controller:
            return "rival"
        self._anyone = False
        if hello.verdict == "accepted":
            self._met.accepted = self._known = True
            return "accepted"
        self._begin_session(new_session)
        self._met.accepted = False
        return "ended"

    def _greeted(
        self, hello: ControllerHello, new_session: str
    ) -> Literal["nothing", "greet", "ended", "rival"]:
        """A controller is there: ask it, unless the session is with another that may still live."""
        record = self.record
        asked = self._met.controller
        returned = hello.session == record.session  # from the journal that the session was kept in
        if not (hello.instance == asked or returned or self._anyone):
            return "nothing" if asked is None else "rival"
        self._anyone = False
        if hello.instance == asked:
            return "greet"
        self._met = _Acquaintance(hello.instance)
        taken = record.controller not in ("", hello.instance)
        self.record = record._replace(controller=hello.instance)
        if taken and not returned and not record.transitions:
            self._begin_session(new_session)
            return "ended"
        return "greet"

    def measurement(self) -> Measurement:
        """Measurement(k): the state, the last applied offer and what came right after it."""
        record = self.record
        return Measurement(
            session=record.session,
            k=record.k,
            x=record.x,
            applied_k=record.applied_k,
            x_after=record.x_after,
        )

    def moved(self, x_next: Vector) -> Measurement:
        """Measurement(k + 1), once an offer has been applied and led to ``x_next``.

        It can be made, and sent, before :meth:`applied` has counted the transition.
        """
        record = self.record
        return Measurement(
            session=record.session,
            k=record.k + 1,
            x=x_next,
            applied_k=record.k,
            x_after=x_next,
        )

    def check(self, offer: Offer) -> Literal["current", "stale", "foreign"]:
        """Whether an offer is for this session and this step (rule 5).

        Raises
        ------
        ValueError
            When its shape is not the plant's, or a candidate is not admissible: garbage.
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
        if offer.cipher >= rules.size:
            raise ValueError(f"offer.cipher: got {offer.cipher}, expected below {rules.size}")
        if offer.session != self.record.session:
            return "foreign"
        return "current" if offer.k == self.record.k else "stale"

    def applied(self, offer: Offer, coin: int, x_next: Vector) -> ReceiverEffects:
        """Count the transition of the ``current`` offer, of which candidate ``coin`` was applied.

        The key is what the test returns, as for the controller; ``coin`` is only compared with it.
        """
        record = self.record
        self._anyone = False
        scheme = self.rules.scheme
        verdict = self.rules.agreement.verdict(record.x, offer.candidates, x_next)
        after, (agreed, pad) = scheme.advance(record.state, verdict.symbol)
        recovered = decrypt(offer.cipher, pad, scheme.alphabet)
        carried = pad != NO_SYMBOL
        if not carried:
            recovered = NO_SYMBOL
        frame = None
        partial, chunk = record.partial, ""
        if carried:
            frame = self.deframer.push(recovered)
            if not self.deframer.symbols:
                partial = ""
            else:
                partial += f"{recovered:0{self._digits}x}"
                if len(partial) >= CHUNK * self._digits:
                    partial, chunk = "", partial
        p = record.p + (1 if carried else 0)
        transition = Transition(
            session=record.session,
            j=record.transitions,
            k=record.k,
            x=record.x,
            candidates=offer.candidates,
            cipher=offer.cipher,
            x_next=x_next,
            role="message" if carried else "test",
            verdict=verdict,
            symbol=agreed,
            key=pad,
            message_symbol=recovered,
            p=p,
            s=after[0],
            tested=scheme.tests(record.state),
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
            p=p,
            agreements=record.agreements + (1 if agreed != NO_SYMBOL else 0),
            symbol_errors=record.symbol_errors + (1 if agreed not in (NO_SYMBOL, coin) else 0),
            messages=record.messages + (1 if frame is not None and frame.intact else 0),
            frames_refused=record.frames_refused
            + (1 if frame is not None and not frame.intact else 0),
        )
        return ReceiverEffects(transition, chunk, frame)

    def missed(self, u: Vector, x_next: Vector) -> None:
        """No offer came in time: the fallback input ``u`` was applied (rule 4)."""
        record = self.record
        self.record = record._replace(k=record.k + 1, x=x_next, u=u, missed=record.missed + 1)

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
        )
