"""Adversary messages: what the tap tells whoever watches it."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Final, Self

from pydantic import Field, model_validator

from protocol.messages.base import MALFORMED, Count, Message, Metric
from protocol.vectors import FiniteVector


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
    mirrored, dropped, malformed : int
        Messages that the tap has recorded, has heard and lost, and could not read.
    behind : int
        Captured steps that Eve has not looked at.
    foreign, late : int
        Messages that the tap heard and could not use: those of other sessions or of steps far
        ahead, and those that came after their step was given out without them.
    jumped : int
        Steps that the tap skipped, as it heard nothing of them.
    restarts : int
        Times that the eavesdropper's process was started again.
    message : str
        Eve's best message so far; unprintable bytes are shown as ``·``.
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
    failed : str
        Why Eve does not guess at present; empty: Eve does. The other fields then keep Eve's last
        words.
    A, B : tuple of tuple of float
        The model that Eve has learned or was given; empty: none.
    key_blocks, key_bits_held : int
        Key blocks that Eve attacked, and bits of their rows that Eve can compute; -1 bits: Eve
        attacks no keys. The fields up to ``misses_in_bursts`` are those of one who does.
    copies, copies_missed : int
        Copies 0 that were sent while Eve was there, and those of them that Eve missed.
    copies_absent : int
        Copies 0 that were sent while Eve was not there.
    missed_direction, missed_at_most : str, float
        The direction that speaks most against the operator's claim, and the upper bound of the
        share of its copies that Eve misses.
    key_steps_unplaced : int
        Transitions that Eve could place in no block: nothing is known of their keys.
    claim_refuted, misses_in_bursts : bool
        Eve misses less than the operator claims; Eve's misses come in bursts.
    tail_k, tail_symbol : tuple of int
        Of the last transitions, oldest first: the step k, and the symbol that Eve holds likeliest.
    tail_probability, tail_agreed : tuple of float
        Probability of that symbol, and that a key was agreed on there, by Eve's account. All four
        tails have one length.
    """

    topic: ClassVar[str] = "adversary/tap/status"
    seq: Count
    t_ns: Count
    name: str
    steps: Count
    lost: Annotated[Count, Metric("tap_lost", "transitions of which the tap lacks a message")]
    mirrored: Annotated[Count, Metric("tap_mirrored", "messages in the tap's recording")]
    dropped: Annotated[Count, Metric("tap_dropped", "messages that the tap heard and lost")]
    behind: Count
    malformed: Annotated[Count, MALFORMED]
    foreign: Count = 0
    late: Count = 0
    jumped: Count = 0
    restarts: Count = 0
    message: str
    confidence: float
    candidates_left: Count
    solved_k: Annotated[int, Field(ge=-1)]
    bits_left: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    given: str = ""
    failed: str = ""
    A: tuple[FiniteVector, ...] = ()
    B: tuple[FiniteVector, ...] = ()
    key_blocks: Annotated[
        Count, Metric("keys_blocks_attacked", "key blocks that the eavesdropper went for")
    ] = 0
    key_bits_held: Annotated[
        int, Field(ge=-1), Metric("keys_bits_held", "bits of their rows that Eve can compute")
    ] = -1
    copies: Annotated[
        Count, Metric("keys_copies", "first copies that were sent, as far as Eve can tell")
    ] = 0
    copies_missed: Annotated[
        Count, Metric("keys_copies_missed", "first copies that Eve missed")
    ] = 0
    missed_at_most: float = 1.0
    missed_direction: str = ""
    copies_absent: Count = 0
    key_steps_unplaced: Count = 0
    claim_refuted: Annotated[
        bool,
        Metric(
            "keys_claim_refuted",
            "whether Eve misses less than the operator claims (eps_E)",
            now=True,
        ),
    ] = False
    misses_in_bursts: Annotated[
        bool, Metric("keys_misses_in_bursts", "whether Eve's misses come in bursts", now=True)
    ] = False
    tail_k: tuple[int, ...] = ()
    tail_symbol: tuple[int, ...] = ()
    tail_probability: FiniteVector = ()
    tail_agreed: FiniteVector = ()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        tails = (self.tail_k, self.tail_symbol, self.tail_probability)
        if any(len(tail) != len(self.tail_agreed) for tail in tails):
            raise ValueError("expected tails of one length")
        return self


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
