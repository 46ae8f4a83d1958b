"""The controller's end of the frames: queued messages go in, cipher symbols come out."""

from controller_service.outbox import MessageQueue
from protocol.agreement import NO_SYMBOL
from protocol.link.records import LinkRecord, OutgoingRecord
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
            self.record = self._decided(LinkRecord(state=self._rules.scheme.initial), message, 0)

    def following(self, link: LinkRecord, decided: int | None) -> OutgoingRecord:
        """The record after a transition, which has carried what it had to.

        Parameters
        ----------
        link : LinkRecord
            What follows from it.
        decided : int, optional
            The cipher symbol of an answer that was given before.
        """
        message, offset = self.record.message, self.record.offset
        if self.record.framed and offset == len(self._frame_of(message)):
            message, offset = message + 1, 0
        return self._decided(link, message, offset, decided)

    def _decided(
        self, link: LinkRecord, message: int, offset: int, decided: int | None = None
    ) -> OutgoingRecord:
        """Decide the cipher symbol of the transition to come: once, and never again (rule 3).

        The record that follows has it, with where in the queue the next message symbol comes from.
        Under the key stream the message symbol is decided, and each offer encrypts it anew
        (:meth:`cipher`).
        """
        size, scheme = self._rules.size, self._rules.scheme
        pad = scheme.pad(link.state)
        if pad == NO_SYMBOL and not scheme.from_stream:
            cover = scheme.clear(link.state) if decided is None else decided
            if cover == NO_SYMBOL:
                cover = self._fresh.symbol(link.transitions, size)
            return OutgoingRecord(cover, message=message, offset=offset)
        symbols = self._frame_of(message)
        framed = bool(symbols)
        symbol = symbols[offset] if framed else IDLE
        cipher = 0 if scheme.from_stream else encrypt(symbol, pad, size)
        return OutgoingRecord(cipher, symbol, framed, message, offset + framed)

    def cipher(self, record: OutgoingRecord, link: LinkRecord, digits: tuple[int, ...]) -> int:
        """The cipher symbol of an offer.

        Under the key stream it is the message symbol under the offer's ``digits``, and random where
        the offer has none.
        """
        size = self._rules.size
        if not self._rules.scheme.from_stream:
            return record.cipher
        if not digits:
            return self._fresh.symbol(link.transitions, size)
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
