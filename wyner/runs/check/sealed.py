"""The check of sealed messages: what travels is what was sealed, each under keys of its own."""

from contextlib import ExitStack
from hashlib import sha256

from protocol.messages import Sealed
from protocol.secret.sealed import keys_needed
from runtime.keys.sealed_book import SealedBook, SealedText
from wyner.runs.check.base import Check, Counter
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.key_blocks import FILES, open_store


class SealedOnce(Check):
    """A key seals one message, and what travels is what both ends' stores have of it."""

    name = "sealed-once"
    source = "rule 11"
    says = "a key seals one message, which travels as both ends have it"
    of = "messages"
    needs = ("wire",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._travelled: dict[str, SealedText] = {}
        self._owner: dict[str, str] = {}

    def feed(self, part: Part) -> None:
        for seen in part.sealed:
            text = _text(seen)
            if text is None:
                continue  # another check says so
            problem = _unlike(text, self._travelled.setdefault(text.identifier, text))
            for name in text.key_ids:
                owner = self._owner.setdefault(name, text.identifier)
                if owner != text.identifier:
                    problem = problem or f"key {name} sealed {owner} already"
            if len(set(text.key_ids)) != keys_needed(len(text.cipher)):
                problem = problem or f"{len(text.cipher)} bytes under {len(text.key_ids)} keys"
            where = f"{seen.where}: sealed {text.identifier}: {problem}"
            self.counter.count(not problem, "", -1, -1, where)

    def finish(self) -> None:
        """Compare with what the controller sealed and the plant opened, where their stores are."""
        travelled, count = self._travelled, self.counter.count
        with ExitStack() as stack:
            controller, plant = (
                open_store(self.evidence, side, name, self.counter, stack) for side, name in FILES
            )
            opened = {} if plant is None else dict(SealedBook(plant).opened())
            if controller is not None:
                sent = {
                    text.identifier: (text, digest)
                    for text, digest in SealedBook(controller).sent()
                }
                for name, text in travelled.items():
                    mine = sent.get(name)
                    problem = "was never sealed" if mine is None else _unlike(text, mine[0])
                    count(not problem, "", -1, -1, f"sealed {name}: the controller: {problem}")
                for name, payload in opened.items():
                    same = name in sent and sent[name][1] == sha256(payload).digest()
                    count(same, "", -1, -1, f"sealed {name}: opened, and not as it was sealed")
            for name, payload in opened.items():
                clear = name in travelled and travelled[name].cipher == payload
                count(not clear, "", -1, -1, f"sealed {name}: its text travelled in the clear")
        self.counter.note = f"{len(travelled)} messages, {len(opened)} opened"


def _text(seen: CapturedMessage) -> SealedText | None:
    try:
        message = Sealed.model_validate_json(seen.raw)
    except ValueError:
        return None
    return SealedText(message.id, message.key_ids, message.cipher, message.tag)


def _unlike(text: SealedText, other: SealedText) -> str:
    fields = [f for f in SealedText._fields if getattr(text, f) != getattr(other, f)]
    return f"another {', '.join(fields)}" if fields else ""
