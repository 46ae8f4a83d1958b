"""Intel messages: what the tap tells whoever watches it."""

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from protocol.messages.base import Count, Message
from protocol.vectors import FiniteVector


class TapStatus(Message):
    """One eavesdropper's view of the link, published by the tap at a bounded rate.

    The ``tail_*`` lists are parallel, oldest first: the transition's step k, the likeliest symbol,
    its probability, and the probability that a key was agreed there. ``message`` is the best
    message so far (text, unprintable bytes shown as ``·``), ``confidence`` how sure she is of it.
    ``candidates_left`` counts the messages still possible to her (0: not counted by this kind).
    ``A``, ``B`` are the model she has learned or was given; ``solved_k`` is the step at which she
    first was sure of a whole message (-1: not yet). ``bits_left`` is the entropy of the message
    given all that she heard, in bits, by her own account (None: this kind does not compute it).
    ``failed`` says why she guesses no more, or not at present (empty: she does); the rest is then
    what she said last. ``behind`` counts the steps captured that she has not looked at.
    Of one who attacks keys: ``key_blocks`` made keys, ``key_bits_held`` is what she can compute of
    their rows (-1: this one does not try). Of ``copies`` 0 she missed ``copies_missed``. Of
    those of ``missed_direction``, which speaks against the claim most, she missed a share of
    ``missed_at_most``; that may refute it. Not among them are ``copies_absent``, sent while she was
    not there. Of sealed texts heard lately she knows
    ``sealed_bits_known``; ``sealed_text`` is the last one, with · for what she does not.
    """

    topic: ClassVar[str] = "intel/tap/status"
    seq: Count
    t_ns: Count
    name: str
    steps: Count
    lost: Count
    mirrored: Count
    dropped: Count
    behind: Count
    malformed: Count
    message: str
    confidence: float
    candidates_left: Count
    solved_k: Annotated[int, Field(ge=-1)]
    bits_left: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    failed: str = ""
    A: tuple[FiniteVector, ...] = ()
    B: tuple[FiniteVector, ...] = ()
    key_blocks: Count = 0
    key_bits_held: Annotated[int, Field(ge=-1)] = -1
    copies: Count = 0
    copies_missed: Count = 0
    missed_at_most: float = 1.0
    missed_direction: str = ""
    copies_absent: Count = 0
    claim_refuted: bool = False
    misses_in_bursts: bool = False
    sealed_bits: Count = 0
    sealed_bits_known: Count = 0
    sealed_text: str = ""
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


INTEL: tuple[type[Message], ...] = (TapStatus,)
