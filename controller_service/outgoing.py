"""The controller's end of the frames: queued messages go in, cipher symbols come out."""

from controller_service.telemetry import MessageQueue
from protocol.agreement import NO_SYMBOL
from protocol.link.records import SenderRecord
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
    """

    def __init__(self, rules: Rules, messages: MessageQueue, fresh: SymbolSource) -> None:
        self._rules = rules
        self._messages = messages
        self._fresh = fresh
        self._frame: tuple[int, bytes] = (-1, b"")

    def following(
        self, record: SenderRecord, state: tuple[int, ...], decided: int | None
    ) -> SenderRecord:
        """The record after the transition of ``record``, which has carried what it had to."""
        message, offset = record.message, record.offset
        # The frame is looked at in every state, as in `decide`.
        if offset == len(self._frame_of(message)) and record.framed:
            message, offset = message + 1, 0
        return self.decide(record, state, record.transitions + 1, message, offset, decided)

    def decide(
        self,
        record: SenderRecord,
        state: tuple[int, ...],
        transitions: int,
        message: int,
        offset: int,
        decided: int | None = None,
    ) -> SenderRecord:
        """Decide the cipher symbol of the transition to come: once, and never again (rule 3).

        The record that follows has it, with where in the queue the next message symbol comes from.
        Both decisions are made in both states, and one is taken, so that neither takes longer.
        Under the key stream the message symbol is decided, and each offer encrypts it anew
        (:meth:`cipher`). ``decided`` is the symbol of an answer that was given before.
        """
        size, scheme = self._rules.size, self._rules.scheme
        pad = scheme.pad(state)
        fresh = 0
        if decided is not None:
            fresh = decided
        elif not scheme.from_stream:
            fresh = self._fresh.symbol(transitions, size)
            clear = scheme.clear(state)
            fresh = fresh if clear == NO_SYMBOL else clear
        symbols = self._frame_of(message)
        framed = bool(symbols)
        message_symbol = symbols[offset] if framed else IDLE
        carrying = record._replace(
            state=state,
            cipher=0 if scheme.from_stream else encrypt(message_symbol, pad, size),
            message_symbol=message_symbol,
            framed=framed,
            message=message,
            offset=offset + framed,
        )
        cover = record._replace(
            state=state,
            cipher=fresh,
            message_symbol=NO_SYMBOL,
            framed=False,
            message=message,
            offset=offset,
        )
        if pad == NO_SYMBOL and not scheme.from_stream:
            return cover
        return carrying

    def cipher(self, record: SenderRecord, digits: tuple[int, ...] | None) -> int:
        """The cipher symbol of an offer that has these digits of the key stream, or none."""
        size = self._rules.size
        if not self._rules.scheme.from_stream:
            return record.cipher
        if digits is None:
            return self._fresh.symbol(record.transitions, size)
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
