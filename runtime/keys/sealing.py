"""Both ends of sealed messages, beside the control loop.

They use the keys that the loop has made; neither waits for the other. The controller's end seals a
message and repeats it until the plant's end has opened and acknowledged it; then comes the next
one. The two also ask each other which keys may be given (:mod:`runtime.keys.asking`).
"""

from math import inf
from typing import Protocol

from pydantic import ValidationError

from protocol.link.peer import NOTHING_TO_DO, Actions, Notice
from protocol.messages import Message, SealCommand, Sealed, SealedReceipt, SealReply
from protocol.schemes.framing import MAX_PAYLOAD
from protocol.secret.records import KeysRefused, UnknownKeys
from protocol.secret.sealed import Unsealed, keys_needed
from runtime.keys.asking import REPEAT_S, Asker
from runtime.keys.sealed_book import SealedBook, SealedText


class End(Protocol):
    """One end: message types that it receives and sends, and when it wants to be woken."""

    hears: tuple[type[Message], ...]
    says: tuple[type[Message], ...]

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """Take a message that arrived at ``now``, in seconds."""

    def wake_at(self) -> float:
        """When :meth:`wake` is due."""

    def wake(self, now: float) -> Actions:
        """Do what is due at ``now``."""

    def finish_step(self) -> Actions:
        """Nothing: no step waits for a sealed message."""
        return NOTHING_TO_DO


class SealingEnd(End):
    """The controller's end: takes messages from the operator and sends them sealed.

    Attributes
    ----------
    due_at : float
        When a message is sent again, or keys are looked for again, in seconds.
    """

    hears: tuple[type[Message], ...] = (SealCommand, SealedReceipt, *Asker.hears)
    says: tuple[type[Message], ...] = (Sealed, SealReply, *Asker.says)

    def __init__(self, book: SealedBook, now: float) -> None:
        self._book = book
        self._asker = Asker(book)
        self.due_at = now if book.waiting() else inf

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """Take an operator's message, the plant's acknowledgement, or a message about keys."""
        if kind in Asker.hears:
            actions = self._asker.receive(kind, payload)
            self.due_at = now if self._book.waiting() else inf
            return actions
        try:
            if kind is SealCommand:
                return self._commanded(SealCommand.model_validate_json(payload), now)
            receipt = SealedReceipt.model_validate_json(payload)
        except ValidationError as error:
            text = f"sealing: {error.error_count()} fields not as expected; ignored"
            return Actions(notices=(Notice(text, "warning", "malformed"),))
        if receipt.refused:
            if not self._book.give_up(receipt.id, receipt.key_ids):
                return NOTHING_TO_DO
            told = f"sealed message {receipt.id} given up: the plant cannot open it: "
            notice = Notice(f"{told}{receipt.refused}", "error")
        elif self._book.acknowledged(receipt.id):
            notice = Notice(f"sealed message {receipt.id} delivered")
        else:
            return NOTHING_TO_DO
        self.due_at = now if self._book.waiting() else inf
        return Actions(notices=(notice,))

    def wake_at(self) -> float:
        """When :meth:`wake` is due, in seconds."""
        return min(self.due_at, self._asker.wake_at())

    def wake(self, now: float) -> Actions:
        """Send the oldest message that is not acknowledged, and requests about keys."""
        text = None
        notices: tuple[Notice, ...] = ()
        if now >= self.due_at:
            self.due_at = now + REPEAT_S
            try:
                text = self._book.next()
            except KeysRefused as error:
                notices = (Notice(f"nothing can be sealed: {error}", "error", "keys"),)
        publish: tuple[Message, ...] = self._asker.wake(now)
        if text is not None:
            sealed = Sealed(
                id=text.identifier, key_ids=text.key_ids, cipher=text.cipher, tag=text.tag
            )
            publish = (sealed, *publish)
        return Actions(publish=publish, notices=notices)

    def _commanded(self, command: SealCommand, now: float) -> Actions:
        size = len(command.payload)
        accepted, delivered = False, False
        if not 0 < size <= MAX_PAYLOAD:
            detail = f"message: got {size} bytes, expected 1 to {MAX_PAYLOAD}"
        else:
            try:
                state = self._book.queue(command.id, command.payload)
                accepted, delivered = state != "lost", state == "done"
                detail = f"{state}: takes {keys_needed(size)} keys"
                if state == "queued":
                    detail += f", {self._book.store.available()} there"
                    self.due_at = min(self.due_at, now)
                elif state == "lost":
                    detail = f"id: {command.id!r} was given up: the plant had lost its keys; send "
                    detail += "the message again, under another id"
            except (KeysRefused, ValueError) as error:
                detail = str(error)
        reply = SealReply(id=command.id, accepted=accepted, delivered=delivered, detail=detail)
        return Actions(publish=(reply,))


class OpeningEnd(End):
    """The plant's end: opens sealed messages, keeps their texts, and acknowledges them."""

    hears: tuple[type[Message], ...] = (Sealed, *Asker.hears)
    says: tuple[type[Message], ...] = (SealedReceipt, *Asker.says)

    def __init__(self, book: SealedBook) -> None:
        self._book = book
        self._asker = Asker(book)

    def wake_at(self) -> float:
        """When :meth:`wake` is due, in seconds."""
        return self._asker.wake_at()

    def wake(self, now: float) -> Actions:
        """Send requests about keys."""
        return Actions(publish=self._asker.wake(now))

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:  # noqa: ARG002
        """Open a message once. Acknowledge every copy of it, or say why it cannot be opened."""
        if kind in Asker.hears:
            return self._asker.receive(kind, payload)
        try:
            message = Sealed.model_validate_json(payload)
        except ValidationError as error:
            why = f"sealed: {error.error_count()} fields not as expected; ignored"
            return Actions(notices=(Notice(why, "warning", "malformed"),))
        text = SealedText(message.id, message.key_ids, message.cipher, message.tag)
        receipt, told = SealedReceipt(id=message.id), ""
        try:
            if self._book.open(text):
                told = f"sealed message {message.id} opened: {len(message.cipher)} bytes"
        except (Unsealed, KeysRefused, ValueError) as error:
            return Actions(notices=(Notice(f"not opened: {error}", "warning", "sealed"),))
        except UnknownKeys as error:
            # a forger who names other keys is answered too: the controller compares them
            receipt = SealedReceipt(id=message.id, key_ids=message.key_ids, refused=str(error))
            notice = Notice(f"not opened: {error}", "warning", "sealed")
            return Actions(publish=(receipt,), notices=(notice,))
        notices = (Notice(told),) if told else ()
        return Actions(publish=(receipt,), notices=notices)
