"""The field bus's checks: nothing secret, and nothing that tells the two states apart."""

import re
import struct
from array import array
from dataclasses import dataclass, field
from typing import Any, Final

from pydantic import ValidationError

from protocol.agreement import NO_SYMBOL
from protocol.messages import FIELD, Measurement
from wyner.runs.check.attacked import rewrites
from wyner.runs.check.base import Check, Counter
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.records import wrong
from wyner.runs.check.steps import AppliedStep

PUBLIC: Final = {
    topic: frozenset(fields.split())
    for topic, fields in {
        "measurement": "v session k x applied_k x_after copy_number nonce applied_copy block tag",
        "offer": "v session k candidates cipher predictions copy_number nonce heard block tag",
    }.items()
}
"""The field bus's messages and all their fields, written out here so that adding one to the message
types is noticed."""

OF_STREAM: Final = {
    "measurement": frozenset({"keyed"}),
    "offer": frozenset({"stream_block", "stream_at"}),
}
"""What besides travels where the key stream is used."""

WITHOUT_KEYS: Final = {
    "copy_number": 0,
    "nonce": "",
    "applied_copy": 0,
    "heard": 0,
    "block": -1,
    "tag": "",
}
"""What fields of keys hold where the scenario makes none."""

_MODELS: Final = {kind.topic: kind for kind in FIELD}

_ANEW: Final = re.compile(rb'"copy_number":[01],"nonce":"[^"]*",')
"""What a repeated message has anew; where no keys are made it is the same as well."""

_OF_KEYS: Final = re.compile(rb'"(?:nonce|tag)":"[^"]+"')
_STREAM: Final = re.compile(rb',"(?:keyed|stream_block|stream_at)":(?:true|false|-?[0-9]+)')
_BLOCK: Final = re.compile(rb'"block":-?[0-9]+')
_AS_LETTERS: Final = str.maketrans("0123456789", "abcdefghij")

BLURRED: Final = "the tap saw numbers blurred, by its own settings"


class _First:
    """The first message of each number, as a 64-bit hash of its bytes."""

    def __init__(self) -> None:
        self._dense: dict[tuple[str, str], array[int]] = {}
        self._sparse: dict[tuple[str, str, int], int] = {}

    def same(self, seen: CapturedMessage) -> bool | None:
        """Whether it is the same as the first of its number; None where it is the first."""
        mine = hash(_ANEW.sub(b"", seen.raw, 1)) or 1
        at = (seen.topic, seen.session)
        found = self._dense.setdefault(at, array("q"))
        k = seen.k
        if 0 <= k < len(found) + 4096:
            if k >= len(found):
                found.extend([0] * (k + 1 - len(found)))
            first, found[k] = found[k], found[k] or mine
        else:  # far ahead of the others
            first = self._sparse.setdefault((*at, k), 0)
            self._sparse[(*at, k)] = first or mine
        return None if not first else first == mine


class SameAnswer(Check):
    """A measurement and an offer of one number never change (rules 1 and 2)."""

    name = "same-answer"
    source = "rule 2"
    says = "a repeated message is the same, but for its copy and nonce"
    of = "messages"
    needs = ("wire",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._first = _First()
        self._repeated = {"measurement": 0, "offer": 0}

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        return super().skipped(evidence) or _blurred(evidence)

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            same = self._first.same(seen)
            if same is not None and seen.topic in self._repeated:
                self._repeated[seen.topic] += 1
            text = ""
            if same is False:
                text = f"{seen.where}: {seen.topic} {seen.k} differs from the first of that number"
            self.counter.count(not text, seen.session, -1, seen.k, text)

    def finish(self) -> None:
        measurements, offers = self._repeated.values()
        self.counter.note = f"{measurements} measurements and {offers} offers repeated"


class Wire(Check):
    """The captured numbers are the plant's own."""

    name = "wire"
    source = "assumption 2"
    says = "what the tap read is what the plant worked with"
    of = "messages"
    needs = ("wire", "plant")

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._older = 0

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        return super().skipped(evidence) or _blurred(evidence)

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            if self.evidence.before(seen):
                self._older += 1
            else:
                _compare(self.evidence, seen, self.counter)

    def finish(self) -> None:
        if self._older:
            self.counter.note = f"{self._older} older than what is left of the plant's trace"


def _blurred(e: Evidence) -> str:
    """Why numbers are not compared; empty where they can be."""
    return BLURRED if e.wire is not None and e.wire.blurred else ""


def _compare(e: Evidence, seen: CapturedMessage, counter: Counter) -> None:
    assert e.plant is not None
    steps, session, k, m = e.steps, seen.session, seen.k, seen.message
    if not steps.knows(session):
        text = f"{seen.where}: of a session that the plant's trace does not have"
        counter.count(session in e.plant.announced, session, -1, k, text)
        return
    first, end = steps.ends(session)
    if not first <= k <= end:
        text = f"{seen.where}: step {k}, the plant made steps {first} to {end - 1}"
        counter.count(False, session, -1, k, text)
        return
    step = steps.find(session, k)
    j = -1 if step is None else step.j
    try:
        unlike = _unlike_offer(e, m, step, k) if seen.topic == "offer" else _unlike(e, seen, step)
    except (LookupError, TypeError, ValueError, struct.error):
        unlike = ["its shape"]
    text = f"{seen.where}: {', '.join(unlike)} unlike the plant's trace" if unlike else ""
    counter.count(not unlike, session, j, k, text)


def _unlike_offer(e: Evidence, m: dict[str, Any], step: AppliedStep | None, k: int) -> list[str]:
    if step is None or step.j == NO_SYMBOL:
        return []  # it was not applied
    unlike = []
    same = e.steps.of_candidates(m["candidates"], m["predictions"]) == step.candidates
    if not same and not (e.plant is not None and rewrites(e.plant.attack, k)):
        unlike.append("candidates")
    if m["cipher"] != step.cipher:
        unlike.append("cipher")
    return unlike


def _unlike(e: Evidence, seen: CapturedMessage, step: AppliedStep | None) -> list[str]:
    """Fields of a measurement that the plant's trace has otherwise."""
    steps, session, m = e.steps, seen.session, seen.message
    unlike = []
    here = step.x if step is not None else None
    before = steps.find(session, seen.k - 1)
    if here is None and before is not None:
        here = before.x_next
    if here is not None and steps.of_state(m["x"]) != here:
        unlike.append("x")
    last = step.last_applied if step is not None else steps.newest(session)
    if m["applied_k"] != last:
        unlike.append("applied_k")
        return unlike
    applied = steps.find(session, last)
    after = m["x_after"]
    if (applied is None) != (after == []) or (
        applied is not None and steps.of_state(after) != applied.x_next
    ):
        unlike.append("x_after")
    return unlike


class PublicFields(Check):
    """Only the two public messages, with exactly their public fields."""

    name = "public-fields"
    source = "assumption 2"
    says = "the field bus carries nothing but public fields"
    of = "messages"
    needs = ("wire",)

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            unlike = self._unlike(seen)
            text = f"{seen.where}: {unlike}" if unlike else ""
            self.counter.count(not unlike, seen.session, -1, seen.k, text)

    def _unlike(self, seen: CapturedMessage) -> str:
        """What a message has that it must not, or has not."""
        rules, topic, keys = self.evidence.rules, seen.topic, self.evidence.scenario.keys
        allowed = PUBLIC.get(topic)
        if allowed is None:
            return f"on {topic!r}"
        if rules.digits:
            allowed |= OF_STREAM.get(topic, frozenset())
        if seen.message.keys() != allowed:
            return f"{topic} with {_extra(frozenset(seen.message), allowed)}"
        try:
            message = _MODELS[topic].model_validate_json(seen.raw, strict=True)
        except ValidationError as error:
            return f"{topic}.{wrong(error)}"
        if isinstance(message, Measurement):
            n = rules.states
            fits = len(message.x) == n and len(message.x_after) == (message.applied_k >= 0) * n
        else:
            fits = len(message.candidates) == rules.size and message.cipher < rules.size
            fits = fits and {len(u) for u in message.candidates} == {rules.inputs}
            fits = fits and not rules.malformed_predictions(message.predictions)
        if not fits:
            return f"{topic} is not of this plant's shape"
        if keys is not None:
            return ""
        idle = [f for f, value in WITHOUT_KEYS.items() if seen.message.get(f, value) != value]
        return f"{', '.join(idle)}: not as where no keys are made" if idle else ""

    def finish(self) -> None:
        assert self.evidence.wire is not None
        for problem in self.evidence.wire.strange:
            text = f"{problem.where}: neither Measurement nor Offer ({problem.text})"
            self.counter.count(False, "", -1, -1, text)
        self.counter.note = f"{self.evidence.wire.torn} torn lines"


def _extra(fields: frozenset[str], allowed: frozenset[str]) -> str:
    extra, lacking = sorted(fields - allowed), sorted(allowed - fields)
    words = [f"the extra field {name}" for name in extra] + [f"no {name}" for name in lacking]
    return ", ".join(words)


@dataclass(slots=True)
class _Looks:
    """What messages of one kind looked like in one automaton state."""

    shapes: dict[tuple[bytes, int], tuple[CapturedMessage, int]] = field(default_factory=dict)
    bytes: int = 0
    count: int = 0


_DIGITS: Final = b"0123456789abcdef.+-"


def _shape(raw: bytes) -> tuple[bytes, int]:
    """A message's names, lengths and kinds of value: all that is left without digits.

    Of a nonce and a tag that is their length; which block was announced last and which digits an
    offer has follow from what was counted, and that is public.
    """
    keyless = _OF_KEYS.sub(lambda found: str(len(found[0])).translate(_AS_LETTERS).encode(), raw)
    keyless = _BLOCK.sub(b"", keyless, 1)
    keyless = _STREAM.sub(b"", keyless)
    return keyless.translate(None, _DIGITS), raw.count(b"[]")


class SameShape(Check):
    """Fields, lengths and kinds of number do not depend on the automaton state."""

    name = "same-shape"
    source = "proposition 3"
    says = "messages look the same in both automaton states"
    of = "messages"
    needs = ("wire", "plant")

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._looks: dict[tuple[str, bool], _Looks] = {}

    def feed(self, part: Part) -> None:
        for seen in part.seen:
            step = self.evidence.steps.find(seen.session, seen.k)
            if step is None or step.j == NO_SYMBOL or seen.message.get("applied_k") == -1:
                continue  # a session's first measurement has no x_after yet, in state 1 always
            look = self._looks.setdefault((seen.topic, step.pad != NO_SYMBOL), _Looks())
            look.shapes.setdefault(_shape(seen.raw), (seen, step.j))
            look.bytes += len(seen.raw)
            look.count += 1
            self.counter.counted += 1

    def finish(self) -> None:
        notes = []
        for topic in PUBLIC:
            tests, carries = self._looks.get((topic, False)), self._looks.get((topic, True))
            if tests is None or carries is None:
                continue
            for mine, other, state in ((carries, tests, 2), (tests, carries, 1)):
                for shape, (seen, j) in mine.shapes.items():
                    if shape not in other.shapes:
                        text = f"{seen.where}: {topic} looks like this in state {state} only"
                        self.counter.fail(seen.session, j, seen.k, text)
            means = [look.bytes / look.count for look in (tests, carries)]
            notes.append(f"{topic} {means[0]:.1f} and {means[1]:.1f} bytes")
        if notes:
            self.counter.note = f"mean in states 1 and 2: {'; '.join(notes)}"
