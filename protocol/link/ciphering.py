"""The cipher symbols that the controller sends: a message's under a key, random ones in between."""

from typing import Any, NamedTuple, Protocol

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Scheme, encrypt
from protocol.schemes.framing import IDLE, encode_frame
from protocol.streams import SymbolSource


class Outbox(Protocol):
    """The queue of messages to deliver, in order, numbered from 0."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""


class Decision(NamedTuple):
    """The decided symbol of the next transition; its fields are those of the sender's record."""

    cipher: int
    message_symbol: int
    framed: bool
    offset: int


class Ciphering:
    """Decides each cipher symbol from the queue of messages, frame by frame.

    Parameters
    ----------
    scheme : Scheme
    outbox : Outbox
    fresh : SymbolSource
        Random cipher symbols.
    """

    def __init__(self, scheme: Scheme[Any], outbox: Outbox, fresh: SymbolSource) -> None:
        self._scheme = scheme
        self._size = scheme.alphabet
        self._outbox = outbox
        self._fresh = fresh
        self._frame: tuple[int, bytes] = (-1, b"")

    def decide(
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
        fresh = self._fresh.symbol(transitions, self._size) if decided is None else decided
        symbols = self.frame(message)
        framed = bool(symbols)
        message_symbol = symbols[offset] if framed else IDLE
        pad = self._scheme.pad(state)
        cipher = encrypt(message_symbol, pad, self._size)
        both = (
            Decision(cipher, message_symbol, framed, offset + framed),
            Decision(fresh, NO_SYMBOL, False, offset),
        )
        return both[pad == NO_SYMBOL]

    def frame(self, message: int) -> bytes:
        """The frame of a queued message, or nothing while there is none."""
        number, symbols = self._frame
        if number != message:
            payload = self._outbox.payload(message)
            if payload is None:
                return b""
            symbols = encode_frame(payload, self._size)
            self._frame = (message, symbols)
        return symbols
