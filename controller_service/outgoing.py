"""The controller's end of the frames: queued messages go in, cipher symbols come out."""

from controller_service.outbox import MessageQueue
from protocol.agreement import NO_SYMBOL
from protocol.link.records import OutgoingRecord
from protocol.link.session import Rules
from protocol.schemes.base import encrypt
from protocol.schemes.framing import IDLE, encode_frame
from protocol.streams import SymbolSource


class Outgoing:
    """What the transitions to come carry.

    Parameters
    ----------
    rules : Rules
    messages : MessageQueue
    fresh : SymbolSource
        Random cipher symbols.
    record : OutgoingRecord
    """

    def __init__(
        self, rules: Rules, messages: MessageQueue, fresh: SymbolSource, record: OutgoingRecord
    ) -> None:
        self.record = record
        self._rules = rules
        self._messages = messages
        self._fresh = fresh
        self._frame: tuple[int, bytes] = (-1, b"")

    def begin(self, *, decides: bool) -> None:
        """A session is over, and the message under way starts again; in the next one, if any."""
        message = self.record.message
        self.record = OutgoingRecord(message=message)
        if decides:
            self.record = self._decided(self._rules.scheme.initial, 0, message, 0)

    def following(
        self, state: tuple[int, ...], transitions: int, decided: int | None
    ) -> OutgoingRecord:
        """The record after a transition, which has carried what it had to.

        Parameters
        ----------
        state : tuple of int
            The scheme's, after it.
        transitions : int
            Number of the transition to come.
        decided : int, optional
            The cipher symbol of an answer that was given before.
        """
        message, offset = self.record.message, self.record.offset
        if self.record.framed and offset == len(self._frame_of(message)):
            message, offset = message + 1, 0
        return self._decided(state, transitions, message, offset, decided)

    def _decided(
        self,
        state: tuple[int, ...],
        transitions: int,
        message: int,
        offset: int,
        decided: int | None = None,
    ) -> OutgoingRecord:
        """Decide the cipher symbol of the transition to come: once, and never again (rule 3).

        The record that follows has it, with where in the queue the next message symbol comes from.
        Under the key stream the message symbol is decided, and each offer encrypts it anew
        (:meth:`cipher`).
        """
        size, scheme = self._rules.size, self._rules.scheme
        pad = scheme.pad(state)
        if pad == NO_SYMBOL and not scheme.from_stream:
            cover = decided
            if cover is None:
                clear = scheme.clear(state)
                cover = self._fresh.symbol(transitions, size) if clear == NO_SYMBOL else clear
            return OutgoingRecord(cover, NO_SYMBOL, framed=False, message=message, offset=offset)
        symbols = self._frame_of(message)
        framed = bool(symbols)
        symbol = symbols[offset] if framed else IDLE
        cipher = 0 if scheme.from_stream else encrypt(symbol, pad, size)
        return OutgoingRecord(cipher, symbol, framed, message, offset + framed)

    def cipher(
        self, record: OutgoingRecord, transitions: int, digits: tuple[int, ...] | None
    ) -> int:
        """The cipher symbol of an offer that has these digits of the key stream, or none."""
        size = self._rules.size
        if not self._rules.scheme.from_stream:
            return record.cipher
        if digits is None:
            return self._fresh.symbol(transitions, size)
        return encrypt(record.message_symbol, digits[-1], size)

    def _frame_of(self, message: int) -> bytes:
        """The frame of a queued message, or nothing while there is none."""
        number, symbols = self._frame
        if number != message:
            payload = self._messages.payload(message)
            if payload is None:
                return b""
            symbols = encode_frame(payload, self._rules.size)
            self._frame = (message, symbols)
        return symbols
