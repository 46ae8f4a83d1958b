"""Both ends of sealed messages, beside the control loop: sealed, repeated, opened, acknowledged.

They use the keys that the loop has made, and neither wait for it nor hold it up. A message goes out
again until the plant has acknowledged it; the next one only after that.
"""

from math import inf
from typing import Final, Protocol

from pydantic import ValidationError

from protocol.link.endpoint import NOTHING_TO_DO, Actions, Notice, Outgoing
from protocol.messages import Message, SealCommand, Sealed, SealedReceipt, SealReply
from protocol.schemes.framing import MAX_PAYLOAD
from protocol.secret.records import KeysRefused, UnknownKeys
from protocol.secret.sealed import Unsealed, keys_needed
from protocol.secret.sealed_book import SealedBook, SealedText


class End(Protocol):
    """One end: what it hears and says, and when it wants to be woken."""

    hears: tuple[type[Message], ...]
    says: tuple[type[Message], ...]

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """A message came."""

    def wake_at(self) -> float:
        """When :meth:`wake` is due."""

    def wake(self, now: float) -> Actions:
        """Do what is due at ``now``."""


REPEAT_S: Final = 0.25
"""Seconds after which a message goes out again, or keys are looked for again."""


class SealingEnd:
    """The controller's: takes messages from the operator and sends them sealed."""

    hears: tuple[type[Message], ...] = (SealCommand, SealedReceipt)
    says: tuple[type[Message], ...] = (Sealed, SealReply)

    def __init__(self, book: SealedBook, now: float) -> None:
        self._book = book
        self._due_at = now if book.waiting() else inf

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """A message to be sealed, or the plant's acknowledgement."""
        try:
            if kind is SealCommand:
                return self._commanded(SealCommand.model_validate_json(payload), now)
            receipt = SealedReceipt.model_validate_json(payload)
        except ValidationError as error:
            text = f"sealing: {error.error_count()} fields not as expected; ignored"
            return Actions(notices=(Notice(text, "warning", "garbage"),))
        if not self._book.acknowledged(receipt.id):
            return NOTHING_TO_DO
        self._due_at = now if self._book.waiting() else inf
        return Actions(notices=(Notice(f"sealed message {receipt.id} delivered"),))

    def wake_at(self) -> float:
        """When a message is to go out again, or may at last be sealed."""
        return self._due_at

    def wake(self, now: float) -> Actions:
        """Send the oldest message that was not acknowledged."""
        if now < self._due_at:
            return NOTHING_TO_DO
        self._due_at = now + REPEAT_S
        try:
            text = self._book.next()
        except KeysRefused as error:
            return Actions(notices=(Notice(f"nothing can be sealed: {error}", "error", "keys"),))
        if text is None:
            return NOTHING_TO_DO
        sealed = Sealed(id=text.identifier, key_ids=text.key_ids, cipher=text.cipher, tag=text.tag)
        return Actions(publish=(Outgoing(Sealed, sealed.wire()),))

    def _commanded(self, command: SealCommand, now: float) -> Actions:
        size = len(command.payload)
        accepted, delivered = False, False
        if not 0 < size <= MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected 1 to {MAX_PAYLOAD}"
        else:
            try:
                state = self._book.queue(command.id, command.payload)
                accepted, delivered = True, state == "done"
                detail = f"{state}: takes {keys_needed(size)} keys"
                if state == "queued":
                    detail += f", {self._book.store.available()} there"
                    self._due_at = min(self._due_at, now)
            except (KeysRefused, ValueError) as error:
                detail = str(error)
        reply = SealReply(id=command.id, accepted=accepted, delivered=delivered, detail=detail)
        return Actions(publish=(Outgoing(SealReply, reply.wire()),))


class OpeningEnd:
    """The plant's: opens what comes, keeps it, and acknowledges it."""

    hears: tuple[type[Message], ...] = (Sealed,)
    says: tuple[type[Message], ...] = (SealedReceipt,)

    def __init__(self, book: SealedBook) -> None:
        self._book = book

    def wake_at(self) -> float:
        """Never by itself."""
        return inf

    def wake(self, now: float) -> Actions:  # noqa: ARG002
        """Nothing is due."""
        return NOTHING_TO_DO

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:  # noqa: ARG002
        """Open a message once; acknowledge it each time that it comes."""
        try:
            message = Sealed.model_validate_json(payload)
            text = SealedText(message.id, message.key_ids, message.cipher, message.tag)
            first = self._book.open(text)
        except ValidationError as error:
            why = f"sealed: {error.error_count()} fields not as expected; ignored"
            return Actions(notices=(Notice(why, "warning", "garbage"),))
        except (Unsealed, UnknownKeys, KeysRefused, ValueError) as error:
            return Actions(notices=(Notice(f"not opened: {error}", "warning", "sealed"),))
        receipt = Outgoing(SealedReceipt, SealedReceipt(id=message.id).wire())
        told = f"sealed message {message.id} opened: {len(message.cipher)} bytes"
        return Actions(publish=(receipt,), notices=(Notice(told),) if first else ())
