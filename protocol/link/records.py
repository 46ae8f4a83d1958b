"""What each end must not forget, as its journal keeps it."""

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


class SenderRecord(NamedTuple):
    """All that the controller must not forget, as its journal keeps it.

    ``state`` is the scheme's. ``cipher`` is the decided symbol of the next transition and
    ``message_symbol`` the m[p] inside it (-1 in a cover); ``message`` and ``offset`` say where in
    which queued frame the next message symbol comes from, and ``framed`` whether the pending one
    came from there or is idle.
    ``offer`` is the one answer that may still be applied, ``nonce`` that of the measurement it
    answers, if its copy 0 came first; ``block`` and ``tag`` are the key block announced last and
    its tag. ``confirmed`` is the newest block whose digits have joined the stream, ``refuted`` says
    why the claim that keys rest on does not hold, and ``unwatched`` is the sum of
    :class:`protocol.defence.watch.Watch`. ``incarnation`` counts the processes that had this
    journal. ``failed`` is what the alarm's rule remembers of the last tests; ``halted``: an alarm
    has ended the offers. ``estimate`` is what the last transition left of the box in which the
    state lies, where some outputs alone are read.
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
    incarnation: int = 0
    confirmed: int = -1
    refuted: str = ""
    unwatched: float = NEVER
    failed: int = 0
    halted: bool = False
    estimate: Estimate | None = None

    @property
    def s(self) -> int:
        """What the automaton is doing, by number."""
        return self.state[0]


class ReceiverRecord(NamedTuple):
    """All that the plant must not forget, as its journal keeps it.

    ``applied_k`` and ``x_after`` report the last applied offer and the plant right after it; ``u``
    is the input in force, which the fallback may hold; ``partial`` has the newest symbols of the
    frame under way in hexadecimal digits, and ``stored`` counts the digits before, which stand in a
    table of the journal. Counters run over all sessions but ``transitions`` and
    ``p``, which begin with the session. ``controller`` is the process that was asked last to take
    the session up, ``incarnation`` the one of its journal's that it was. ``nonce`` belongs to copy
    0 of Measurement(k); the three fields behind it are those of that message. ``blocks_begun``
    counts key blocks that were begun, in all sessions, whatever became of them. ``sensor_seed`` is
    of the sensors' noise. ``confirmed`` is as the controller's, and ``keyed`` says whether
    the digits of the last applied offer served. Where some outputs alone are read ``estimate`` is
    as the controller's, and ``true_x`` the simulated state, which no reading tells.
    """

    session: str
    k: int
    x: Vector
    u: Vector
    applied_k: int = -1
    x_after: Vector = ()
    partial: str = ""
    stored: int = 0
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
    nonce: str = ""
    applied_copy: Copy = 0
    block: int = -1
    tag: str = ""
    incarnation: int = 0
    blocks_begun: int = 0
    sensor_seed: int = 0
    confirmed: int = -1
    keyed: bool = False
    estimate: Estimate | None = None
    true_x: Vector = ()

    @property
    def s(self) -> int:
        """What the automaton is doing, by number."""
        return self.state[0]


R = TypeVar("R", bound=SenderRecord | ReceiverRecord)


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
