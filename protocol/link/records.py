"""What each end must not forget: the row of its journal, a frozen record for each of its machines.

Each has one module that makes the next value of it; a session's beginning resets them together
(``begin_session`` of an end's state). Both ends count the link (:class:`LinkRecord`) and their keys
(:class:`KeyRecord`) alike.
"""

from typing import Final, Generic, Literal, NamedTuple, TypeVar

from protocol.agreement import NO_SYMBOL
from protocol.box_observer import Estimate
from protocol.defence.watch import NEVER
from protocol.link.step import IDLE, Step
from protocol.messages import Offer
from protocol.secret.nonces import Contribution, Copy
from protocol.secret.stream import NOTHING_HELD, Held
from protocol.vectors import Vector

INITIAL_ID: Final = "initial"
"""Identifier of the message that a controller is started with; no command may take it."""


Side = Literal["controller", "plant"]
"""The two ends of a loop."""


class LinkRecord(NamedTuple):
    """How far the link is, which both ends count alike (:meth:`protocol.link.session.Rules.count`).

    Parameters
    ----------
    k : int
        The step: the plant's own, or that of the measurement answered last; -1 before the first.
    x : tuple of float
        The reading of that step.
    applied_k : int
        Step of the last applied offer of this session; -1 before the first.
    state : tuple of int
        The scheme's.
    transitions, p : int
        Transitions and message symbols of this session.
    agreements : int
        Key symbols agreed; the plant counts those of all sessions.
    nonce : str
        That of copy 0 of Measurement(k). At the controller: empty where another copy came first.
    estimate : Estimate, optional
        What the last transition left of the box in which the state lies, where some outputs alone
        are read.
    """

    k: int = -1
    x: Vector = ()
    applied_k: int = -1
    state: tuple[int, ...] = ()
    transitions: int = 0
    p: int = 0
    agreements: int = 0
    nonce: str = ""
    estimate: Estimate | None = None

    @property
    def s(self) -> int:
        """What the automaton is doing, by number."""
        return self.state[0]

    def at(self, k: int, x: Vector, nonce: str) -> "LinkRecord":
        """The same at step ``k``, which reads ``x``."""
        return self._replace(k=k, x=x, nonce=nonce)


class KeyRecord(NamedTuple):
    """What :class:`protocol.link.distiller.Distiller` must not forget beside rows of blocks.

    Parameters
    ----------
    block, tag : int, str
        The key block that was announced last.
    confirmed : int
        The newest block whose digits have joined the stream.
    begun : int
        Key blocks that were begun, in all sessions, whatever became of them.
    refuted : str
        Why the claim that keys rest on does not hold; empty as long as it does.
    """

    block: int = -1
    tag: str = ""
    confirmed: int = -1
    begun: int = 0
    refuted: str = ""


# --- the plant ------------------------------------------------------------------------------------


class PlantSessionRecord(NamedTuple):
    """What :class:`protocol.link.plant_session.PlantSession` must not forget.

    ``controller`` is the process that was asked last to take the session up, and ``incarnation``
    the one of its journal's that it was. ``sessions`` counts them.
    """

    id: str
    sessions: int = 1
    controller: str = ""
    incarnation: int = 0


class AppliedRecord(NamedTuple):
    """What the plant's stepper (:mod:`plant_service.stepper`) must not forget beside the link.

    ``u`` is the input in force, which the fallback may hold. ``x_after``, ``copy`` and ``keyed``
    are of the last applied offer: the state right after it, which copy it was, and whether its
    digits served. ``missed`` and ``symbol_errors`` are counters over all sessions. ``sensor_seed``
    is of the sensors' noise. Where some outputs alone are read, ``true_x`` is the simulated state,
    which no reading tells.
    """

    u: Vector
    x_after: Vector = ()
    copy: Copy = 0
    keyed: bool = False
    missed: int = 0
    symbol_errors: int = 0
    sensor_seed: int = 0
    true_x: Vector = ()


class IncomingRecord(NamedTuple):
    """What :class:`protocol.link.incoming.Incoming` must not forget.

    ``partial`` has the newest symbols of the frame under way in hexadecimal digits, and ``stored``
    counts the digits before, which stand in a table of the journal. ``messages`` and ``refused``
    count frames that passed their check, and that failed it.
    """

    partial: str = ""
    stored: int = 0
    messages: int = 0
    refused: int = 0


class PlantRecord(NamedTuple):
    """All that the plant must not forget."""

    session: PlantSessionRecord
    link: LinkRecord
    applied: AppliedRecord
    frame: IncomingRecord = IncomingRecord()
    keys: KeyRecord = KeyRecord()


# --- the controller -------------------------------------------------------------------------------


class ControllerSessionRecord(NamedTuple):
    """What :class:`protocol.link.controller_session.ControllerSession` must not forget.

    ``ended`` are sessions that are over, and ``incarnation`` counts the processes that had this
    journal.
    """

    id: str | None = None
    ended: tuple[str, ...] = ()
    incarnation: int = 0


class OutgoingRecord(NamedTuple):
    """What :class:`controller_service.outgoing.Outgoing` must not forget.

    ``cipher`` is the decided symbol of the next transition and ``message_symbol`` the m[p] inside
    it (-1 in a cover). ``message`` and ``offset`` say where in which queued frame the next message
    symbol comes from, and ``framed`` whether the pending one came from there or is idle.
    """

    cipher: int = 0
    message_symbol: int = NO_SYMBOL
    framed: bool = False
    message: int = 0
    offset: int = 0


class AlarmRecord(NamedTuple):
    """What :mod:`controller_service.alarms` must not forget.

    ``failed`` is what the alarm's rule remembers of the last tests, ``unwatched`` the sum of
    :class:`protocol.defence.watch.Watch`; ``halted``: an alarm has ended the offers.
    """

    failed: int = 0
    unwatched: float = NEVER
    halted: bool = False


class ControllerRecord(NamedTuple):
    """All that the controller must not forget; ``offer`` is the one that may still be applied."""

    session: ControllerSessionRecord = ControllerSessionRecord()
    link: LinkRecord = LinkRecord()
    offer: Offer | None = None
    frame: OutgoingRecord = OutgoingRecord()
    alarms: AlarmRecord = AlarmRecord()
    keys: KeyRecord = KeyRecord()


R = TypeVar("R", bound=ControllerRecord | PlantRecord)


class Loaded(NamedTuple, Generic[R]):
    """What a journal holds; a new one holds nothing.

    ``step`` follows the record and is to be counted again, or at the plant was begun and not read.
    ``rows`` are those of key blocks that are still needed, ``held`` is what is left of the key
    stream, ``symbols`` are those of the frame under way that have left the plant's record.
    ``fell_back``: the machine was started again since the last save, and the newest saves may be
    missing.
    """

    record: R | None = None
    step: Step = IDLE
    rows: tuple[Contribution, ...] = ()
    held: Held = NOTHING_HELD
    symbols: str = ""
    fell_back: bool = False
