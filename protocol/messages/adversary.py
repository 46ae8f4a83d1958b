"""Adversary messages: what the tap tells whoever watches it."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Final, NamedTuple

from pydantic import Field, FiniteFloat

from protocol.messages.base import Count, Malformed, Message, Metric, Part
from protocol.vectors import FiniteMatrix


class UnusedStatus(Part):
    """What the tap heard and could not use.

    Attributes
    ----------
    foreign, late : int
        Messages of other sessions or of steps far ahead, and those that came after their step was
        given out without them.
    jumped : int
        Steps that the tap skipped, as it heard nothing of them.
    dropped, malformed : int
        Messages that the tap has heard and lost, and could not read.
    restarts : int
        Times that the eavesdropper's process was started again.
    """

    foreign: Count = 0
    late: Count = 0
    jumped: Count = 0
    dropped: Annotated[Count, Metric("tap_dropped", "messages that the tap heard and lost")] = 0
    malformed: Malformed = 0
    restarts: Count = 0


class BeliefStatus(Part):
    """What an eavesdropper thinks of the message so far.

    Attributes
    ----------
    message : str
        Eve's best message; unprintable bytes are shown as ``·``.
    confidence : float
        How sure Eve is of it, 0 to 1.
    candidates_left : int
        Messages that are still possible to Eve; 0: this kind does not count them.
    solved_k : int
        Step at which Eve first was sure of a whole message; -1: not yet.
    bits_left : float or None
        Entropy of the message given all that Eve heard, in bits, by Eve's own account. None: this
        kind does not compute it.
    given : str
        Which kind of text Eve takes the message for, as ``German``: that entropy is given it too.
    A, B : tuple of tuple of float
        The model that Eve has learned or was given; empty: none.
    """

    message: str = ""
    confidence: float = 0.0
    candidates_left: Count = 0
    solved_k: Annotated[int, Field(ge=-1)] = -1
    bits_left: Annotated[FiniteFloat, Field(ge=0)] | None = None
    given: str = ""
    A: FiniteMatrix = ()
    B: FiniteMatrix = ()


class HeldBlock(Part):
    """A key block as one who attacks keys sees it: ``bits`` are what Eve can compute of its rows.

    ``counted`` copies made ``rows``, of which the first is no key; ``missed`` Eve did not hear.
    """

    session: str
    number: int
    counted: int
    rows: int
    missed: int
    bits: int


class KeysHeld(Part):
    """What one who attacks keys holds of them.

    Attributes
    ----------
    blocks, broken : int
        Blocks that made keys, and those that Eve can compute a bit of.
    bits : int
        Bits of their rows that Eve can compute, by rank.
    copies, missed : int
        Copies 0 that were sent while Eve was there, as far as Eve can tell, and those of them that
        Eve missed.
    at_most : float
        Upper bound of Eve's miss rate in that ``direction`` which speaks against the claim most; it
        holds at all looks together (level 1e-6).
    refuted, bursts : bool
        Whether that is below the claim; whether Eve's misses come in bursts, in either direction.
    absent : int
        Copies 0 that were sent while Eve was not there.
    unplaced : int
        Transitions that Eve heard of and could place in no block: Eve missed the beginning of their
        session, or a stretch of it.
    newest : tuple of HeldBlock
        The last blocks.
    """

    blocks: Annotated[
        Count, Metric("keys_blocks_attacked", "key blocks that the eavesdropper went for")
    ]
    broken: Count
    bits: Annotated[
        Count, Metric("keys_bits_held", "bits of their rows that the eavesdropper can compute")
    ]
    copies: Annotated[
        Count, Metric("keys_copies", "first copies that were sent, as far as Eve can tell")
    ]
    missed: Annotated[Count, Metric("keys_copies_missed", "first copies that Eve missed")]
    at_most: float
    refuted: Annotated[
        bool,
        Metric(
            "keys_claim_refuted",
            "whether Eve misses less than the operator claims (eps_E)",
            "gauge",
        ),
    ]
    bursts: Annotated[
        bool, Metric("keys_misses_in_bursts", "whether Eve's misses come in bursts", "gauge")
    ]
    direction: str = ""
    absent: Count = 0
    unplaced: Count = 0
    newest: tuple[HeldBlock, ...] = ()


class TailGuess(NamedTuple):
    """Eve's guess at a transition: the step, the symbol that Eve holds likeliest, its probability,
    and that a key was agreed on there, by Eve's account."""

    k: int
    symbol: int
    probability: FiniteFloat
    agreed: FiniteFloat


class TapStatus(Message):
    """One eavesdropper's view of the link, published by the tap at a bounded rate.

    Attributes
    ----------
    seq, t_ns : int
        Number of the status, and when it was made, in nanoseconds.
    name : str
        The eavesdropper's.
    steps, lost : int
        Transitions that Eve looked at, and those of which the tap lacks a message.
    mirrored : int
        Messages that the tap has recorded.
    behind : int
        Captured steps that Eve has not looked at.
    failed : str
        Why Eve does not guess at present; empty: Eve does. The other fields then keep Eve's last
        words.
    keys : KeysHeld or None
        None: Eve attacks no keys.
    tail : tuple of TailGuess
        Of the last transitions, oldest first.
    """

    topic: ClassVar[str] = "adversary/tap/status"
    seq: Count = 0
    t_ns: Count = 0
    name: str
    steps: Count = 0
    lost: Annotated[Count, Metric("tap_lost", "transitions of which the tap lacks a message")] = 0
    mirrored: Annotated[Count, Metric("tap_mirrored", "messages in the tap's recording")] = 0
    behind: Count = 0
    failed: str = ""
    unused: UnusedStatus = UnusedStatus()
    belief: BeliefStatus = BeliefStatus()
    keys: KeysHeld | None = None
    tail: tuple[TailGuess, ...] = ()


DEAF: Final = 0.01
"""Share of the steps that a tap could not use from which on it counts as deaf for that share."""


def deaf_share(unused: Mapping[str, int], steps: int) -> float:
    """Share of the steps that a tap could not use, 0 below :data:`DEAF`.

    Parameters
    ----------
    unused : mapping of str to int
        ``foreign``, ``late``, ``dropped`` and ``jumped`` of a status. A step has two messages.
    steps : int
        Steps that were looked at.
    """
    lost = (unused["foreign"] + unused["late"] + unused["dropped"]) / 2 + unused["jumped"]
    share = lost / (lost + steps) if lost else 0.0
    return share if share >= DEAF else 0.0


ADVERSARY: tuple[type[Message], ...] = (TapStatus,)
