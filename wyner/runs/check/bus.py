"""The field bus, as the tap captured it: what may stand on it, and what it must have in common.

One passage over the capture: some thousand messages are looked at together, and of each there is
kept what shows a second one: some 40 bytes.
"""

import re
from array import array
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from protocol.messages import FIELD, Measurement, Offer
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.heard import CapturedMessage, CaptureLines
from wyner.runs.lines import TRANSITION, wrong
from wyner.runs.trace import AT_ONCE, Indices, Places, Trace

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
    "copy_number": 0, "nonce": "", "applied_copy": 0, "heard": 0, "block": -1, "tag": "",
}  # fmt: skip
"""What fields of keys hold where no key is claimed."""

_MODELS: Final = {kind.topic: kind for kind in FIELD}

_ANEW: Final = re.compile(rb'"copy_number":[01],"nonce":"[^"]*",')
"""What a repeated message has anew; where no keys are made it is the same as well."""

_COUNTED: Final = frozenset({"block", "keyed", "stream_block", "stream_at"})
"""Fields that follow from what was counted, which is public, and look as they may."""

Heard = tuple[CapturedMessage, Measurement | Offer]


def bus(e: Evidence, capture: CaptureLines) -> Findings:
    """All that a capture shows."""
    if e.controller is not None:  # there must be room for what a capture takes
        e.controller.let_go()
        e.run.forget("controller")
    steps = None if e.plant is None else Steps(e, e.plant, capture)
    seen, tags = Seen(e), dict[tuple[str, int], str]()
    part: list[Heard] = []
    for line in capture:
        message = _model(e, line)
        if isinstance(message, str):
            yield _at(line, "bus", message)
            continue
        seen.take(line, message)
        if tags.setdefault((message.session, message.block), message.tag) != message.tag:
            yield _at(line, "same-keys", f"block {message.block} had another tag before")
        if steps is None:
            continue
        part.append((line, message))
        if len(part) == AT_ONCE:  # not one more: they take most room
            yield from steps.compare(part)
            part = []
    if steps is not None:
        yield from steps.compare(part)
        yield from steps.telling()
    del steps  # what follows needs its room
    yield from seen.twice(blurred=capture.blurred)
    for where, text in capture.strange:
        yield Finding("bus", "", -1, f"{where}: neither Measurement nor Offer ({text})")


def _model(e: Evidence, line: CapturedMessage) -> Measurement | Offer | str:
    """The message, with exactly its public fields and of the plant's shape; or what it is not."""
    rules, topic = e.rules, line.topic
    allowed = PUBLIC.get(topic)
    if allowed is None:
        return f"on {topic!r}"
    if rules.digits:
        allowed |= OF_STREAM[topic]
    told = {name for name, value in line.message.items() if value is not None}
    if unlike := sorted((line.message.keys() ^ allowed) | (allowed - told)):
        return f"{topic} with a field too many, or one too few: {', '.join(unlike)}"
    try:
        message: Measurement | Offer = _MODELS[topic].model_validate_json(line.raw, strict=True)
    except ValidationError as error:
        return f"{topic}.{wrong(error)}"
    if isinstance(message, Measurement):
        lengths = [rules.states, rules.states * (message.applied_k >= 0)]
        fits = [len(message.x), len(message.x_after)] == lengths
    else:
        fits = [*map(len, message.candidates)] == [rules.inputs] * rules.size
        fits = fits and not rules.malformed_predictions(message.predictions)
        fits = fits and message.cipher < rules.size and max(message.position) < 1 << 31
    if not fits or message.k >= 1 << 31:
        return f"{topic} is not of this plant's shape"
    if rules.schedule is None:
        idle = [f for f, value in WITHOUT_KEYS.items() if line.message.get(f, value) != value]
        if idle:
            return f"{', '.join(idle)}: not as where no keys are made"
    return message


class Steps:
    """Messages beside the plant's steps, found by session and k."""

    def __init__(self, e: Evidence, plant: Trace, capture: CaptureLines) -> None:
        self._e, self._plant, self._rows, self._capture = e, plant, plant.rows, capture
        self._places = Places(plant, plant.rows)
        made = np.flatnonzero(plant.rows["kind"] == TRANSITION)
        self._made = np.concatenate([[-1], made, [-1]]).astype(np.int32)
        self._open: dict[str, int] = {}  # the symbol decided after a session's last transition
        begun = plant.rows[made[:1]]
        self._first_k = int(begun["k"][0]) if len(begun) and begun["session"][0] == 0 else -1
        self._looks = defaultdict[tuple[str, bool], dict[Any, CapturedMessage]](dict)

    def compare(self, part: list[Heard]) -> Findings:
        """Compare messages with the steps."""
        session = np.array([self._places.session(m.session) for _, m in part], np.int64)
        k = np.array([m.k for _, m in part], np.int64)
        here = self._places.all_of(session, k)
        before = np.where(here >= 0, here - 1, self._places.all_of(session, k - 1))
        done = np.searchsorted(self._made[1:-1], before, side="right")  # transitions before
        places = zip(here, before, self._made[done], self._made[done + 1], strict=True)
        for i, ((line, message), at) in enumerate(zip(part, places, strict=True)):
            rows = [self._row(session[i], one) for one in at]
            if rows[0] is not None and rows[0]["kind"] == TRANSITION:
                self._look(line, message, carries=bool(rows[0]["message"]))
            if self._plant.gone and (session[i] < 0 or (session[i] == 0 and k[i] <= self._first_k)):
                continue  # older than what is left of the plant's trace, and its answer
            for rule, text in self._unlike(message, *rows):
                yield _at(line, rule, text)

    def _row(self, session: int, at: int) -> Any:
        """Row ``at``, where there is one and it is of this session."""
        return self._rows[at] if at >= 0 and self._rows[at]["session"] == session else None

    def _unlike(
        self, message: Measurement | Offer, row: Any, last: Any, applied: Any, decided: Any
    ) -> Iterator[tuple[str, str]]:
        """In what a message differs from step k, whose ``row`` may not be made yet.

        Of its session ``last`` is the step before, ``applied`` the last transition before, and
        ``decided`` the first one from there on.
        """
        if row is None and last is None:
            session, plant = message.session, self._plant
            new = session in plant.announced and session not in plant.sessions
            if not new and not plant.may_lack(session, message.k):
                yield "wire", f"step {message.k}, which the plant's trace does not have"
        elif isinstance(message, Offer):
            yield from self._unlike_offer(message, row, decided)
        else:
            yield from self._unlike_measurement(message, row, last, applied)

    def _unlike_measurement(
        self, m: Measurement, row: Any, last: Any, applied: Any
    ) -> Iterator[tuple[str, str]]:
        here = last["x_next"] if row is None else row["x"]
        after = () if applied is None else applied["x_next"].tolist()
        if m.applied_k != (-1 if applied is None else applied["k"]):
            yield "wire", "applied_k unlike the plant's trace"
        elif not self._capture.blurred and m.x_after != tuple(after):
            yield "wire", "x_after unlike the plant's trace"
        if not self._capture.blurred and m.x != tuple(here.tolist()):
            yield "wire", "x unlike the plant's trace"
        if applied is not None and m.applied_copy and applied["counts"] & 1:
            yield "same-keys", "copy 1 of the offer was applied, and the plant counts copy 0"

    def _unlike_offer(self, offer: Offer, row: Any, decided: Any) -> Iterator[tuple[str, str]]:
        """Of what was applied also the candidates; every offer carries its transition's symbol."""
        rules, due = self._e.rules, offer.cipher
        counted = row is not None and row["kind"] == TRANSITION
        if counted and not self._capture.blurred and not self._e.rewrites(offer.k):
            for name in ("candidates", "predictions") if rules.predicted else ("candidates",):
                if list(map(list, getattr(offer, name))) != row[name].tolist():
                    yield "wire", f"{name} unlike the plant's trace"
        if counted and offer.heard and row["counts"] & 2:
            yield "same-keys", "copy 1 of the measurement was heard, the plant counts copy 0"
        if rules.scheme.from_stream:
            due = row["cipher"] if counted else due
        elif decided is None:
            due = self._open.setdefault(offer.session, due)
        else:
            due = decided["cipher"]
        if offer.cipher != due:
            yield "wire", f"cipher {offer.cipher}, decided was {due}"

    def _look(self, line: CapturedMessage, message: Measurement | Offer, *, carries: bool) -> None:
        """Note what a message of a transition looks like, which carried or tested."""
        if isinstance(message, Measurement) and message.applied_k == -1:
            return  # a session's first has no x_after yet, in state 1 always
        self._looks[line.topic, carries].setdefault(_shape(line.message), line)

    def telling(self) -> Findings:
        """Messages that look as none of their kind does in the other automaton state."""
        for (topic, carries), look in self._looks.items():
            other = self._looks.get((topic, not carries), look)
            for shape, line in look.items():
                if shape not in other:
                    yield _at(line, "bus", f"{topic} looks like this in state {1 + carries} only")


def _at(line: CapturedMessage, rule: str, text: str) -> Finding:
    return Finding(rule, line.session, line.k, f"{line.where}: {text}")


def _shape(message: dict[str, Any]) -> tuple[Any, ...]:
    """A message's names in their order, and how long or of which kind each value is."""
    kinds = message | dict.fromkeys(_COUNTED & message.keys())
    return tuple(
        (name, len(value) if isinstance(value, list | str) else type(value))
        for name, value in kinds.items()
    )


class Seen:
    """What shows a second message of one number that differs, and what left twice."""

    def __init__(self, e: Evidence) -> None:
        self._keys, self._digits = e.rules.schedule is not None, e.rules.digits
        self._sessions: dict[str, int] = {}
        self._numbers, self._looks, self._nonces = array("q"), array("q"), array("q")
        self._named, self._positions = array("q"), array("q")

    def take(self, line: CapturedMessage, message: Measurement | Offer) -> None:
        """Note a message."""
        session = self._sessions.setdefault(line.session, len(self._sessions))
        offer, first = isinstance(message, Offer), message.copy_number == 0
        number = session << 34 | line.k << 2 | offer << 1 | first
        self._numbers.append(number)
        self._looks.append(hash(_ANEW.sub(b"", line.raw, 1)))
        if self._keys:
            self._nonces.append(hash(message.nonce))
        if self._digits and isinstance(message, Offer) and message.position.block >= 0:
            self._named.append(number | 1)
            self._positions.append(message.position.block << 32 | message.position.at)

    def twice(self, *, blurred: bool) -> Findings:
        """Messages that are unlike another of their number, and what serves or leaves twice."""
        numbers = np.frombuffer(self._numbers, np.int64)
        if self._keys:
            twice = numbers[_again(np.frombuffer(self._nonces, np.int64))[1]]
            yield from self._told("once", twice, "carries a nonce that was there before")
            self._nonces = array("q")
            first = numbers[numbers & 1 == 1]
            yield from self._told("once", first[_again(first)[1]], "is a second copy 0")
            del first
        if not blurred:
            looks = np.frombuffer(self._looks, np.int64)
            for topic in (0, 2):  # one at a time takes half the room
                at = np.flatnonzero(numbers & 2 == topic)
                before, after = _again(numbers[at] >> 1)
                unlike = numbers[at[after[looks[at[before]] != looks[at[after]]]]]
                yield from self._told("wire", unlike, "differs from another of that number")
        named = np.frombuffer(self._named, np.int64)
        positions = np.frombuffer(self._positions, np.int64)
        order = np.argsort(named, kind="stable")
        number, place = named[order], positions[order]
        further, same = np.diff(place), np.diff(number) == 0
        wrong = np.where(same, further != 0, further < self._digits) & (np.diff(number >> 34) == 0)
        yield from self._told("once", number[1:][wrong], "names digits of another step")

    def _told(self, rule: str, numbers: Indices, text: str) -> Findings:
        sessions = list(self._sessions)
        for number in numbers.tolist():
            topic, k = "offer" if number & 2 else "measurement", number >> 2 & 0xFFFFFFFF
            yield Finding(rule, sessions[number >> 34], k, f"{topic} {k} {text}")


def _again(values: Indices) -> tuple[Indices, Indices]:
    """Places of values that stood at an earlier place, the newest of which comes first."""
    ordered = np.sort(values)
    if (ordered[1:] != ordered[:-1]).all():  # takes less room than the order
        return ordered[:0], ordered[:0]
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    same = ordered[1:] == ordered[:-1]
    return order[:-1][same], order[1:][same]
