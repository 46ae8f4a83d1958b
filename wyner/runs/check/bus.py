"""The field bus, as the tap captured it: what may stand on it, and what it must have in common.

One passage over the capture: some thousand messages are looked at together, as columns, and of each
there is kept what shows a second one: some 40 bytes.
"""

import re
from array import array
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from protocol.messages import FIELD, Measurement, Offer
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.heard import CapturedMessage
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
"""What fields of keys hold where the scenario makes none."""

_MODELS: Final = {kind.topic: kind for kind in FIELD}

_ANEW: Final = re.compile(rb'"copy_number":[01],"nonce":"[^"]*",')
"""What a repeated message has anew; where no keys are made it is the same as well."""

_OF_KEYS: Final = re.compile(rb'"(?:nonce|tag)":"[^"]+"')
_STREAM: Final = re.compile(rb',"(?:keyed|stream_block|stream_at)":(?:true|false|-?[0-9]+)')
_BLOCK: Final = re.compile(rb'"block":-?[0-9]+')
_AS_LETTERS: Final = str.maketrans("0123456789", "abcdefghij")
_DIGITS: Final = b"0123456789abcdef.+-"

Heard = tuple[CapturedMessage, Measurement | Offer]


def bus(e: Evidence) -> Findings:
    """All that a capture shows."""
    if e.capture is None:
        return
    steps = None if e.plant is None else Steps(e, e.plant)
    shapes, seen, stream, tags = Shapes(), Seen(e), Stream(e), Tags(e)
    part: list[Heard] = []
    for message in e.capture:
        found = _model(e, message)
        if isinstance(found, str):
            yield Finding("bus", message.session, message.k, f"{message.where}: {found}")
            continue
        yield from seen.look(message, found)
        yield from stream.look(message, found)
        yield from tags.look(message, found)
        part.append((message, found))
        if len(part) == AT_ONCE:
            if steps is not None:
                yield from steps.compare(part, shapes)
            part = []
    if steps is not None:
        yield from steps.compare(part, shapes)
    yield from shapes.differ()
    yield from seen.twice()
    yield from tags.differ()
    for where, text in e.capture.strange:
        yield Finding("bus", "", -1, f"{where}: neither Measurement nor Offer ({text})")


def _model(e: Evidence, seen: CapturedMessage) -> Measurement | Offer | str:
    """The message, with exactly its public fields and of the plant's shape; or what it is not."""
    rules, topic = e.rules, seen.topic
    allowed = PUBLIC.get(topic)
    if allowed is None:
        return f"on {topic!r}"
    if rules.digits:
        allowed |= OF_STREAM[topic]
    if seen.message.keys() != allowed:
        extra, lacking = (
            sorted(seen.message.keys() - allowed),
            sorted(allowed - seen.message.keys()),
        )
        words = [f"the extra field {name}" for name in extra] + [f"no {name}" for name in lacking]
        return f"{topic} with {', '.join(words)}"
    try:
        message: Measurement | Offer = _MODELS[topic].model_validate_json(seen.raw, strict=True)
    except ValidationError as error:
        return f"{topic}.{wrong(error)}"
    if isinstance(message, Measurement):
        n = rules.states
        fits = len(message.x) == n and len(message.x_after) == (message.applied_k >= 0) * n
    else:
        fits = len(message.candidates) == rules.size and message.cipher < rules.size
        fits = fits and {len(u) for u in message.candidates} == {rules.inputs}
        fits = fits and not rules.malformed_predictions(message.predictions)
    if not fits or message.k >= 1 << 31:
        return f"{topic} is not of this plant's shape"
    if e.scenario.keys is None:
        idle = [f for f, value in WITHOUT_KEYS.items() if seen.message.get(f, value) != value]
        if idle:
            return f"{', '.join(idle)}: not as where no keys are made"
    return message


class Steps:
    """The plant's steps, found by session and k."""

    def __init__(self, e: Evidence, plant: Trace) -> None:
        self._e, self._plant, self._rows = e, plant, plant.rows
        self._places = Places(plant, plant.rows)
        applied = plant.rows["kind"] == TRANSITION
        at = np.arange(len(applied), dtype=np.int32)
        self._newest = np.maximum.accumulate(np.where(applied, at, -1))
        ahead = np.where(applied, at, len(at))
        self._next = np.minimum.accumulate(ahead[::-1])[::-1]
        self._open: dict[str, int] = {}  # the symbol decided after a session's last transition
        begun = plant.rows["k"][applied & (plant.rows["session"] == 0)]
        self._first_k = int(begun[0]) if len(begun) else -1

    @property
    def _blurred(self) -> bool:
        return self._e.capture is not None and self._e.capture.blurred

    def compare(self, part: list[Heard], shapes: "Shapes") -> Findings:
        """Compare messages with the plant's steps."""
        session = np.array([self._places.session(m.session) for _, m in part], np.int64)
        k = np.array([m.k for _, m in part], np.int64)
        here = self._places.all_of(session, k)
        before = np.where(here >= 0, here - 1, self._places.all_of(session, k - 1))
        for i, (seen, message) in enumerate(part):
            row = self._rows[here[i]] if here[i] >= 0 else None
            if row is not None and row["kind"] == TRANSITION:
                shapes.take(seen, message, bool(row["message"]))
            if self._plant.gone and (session[i] < 0 or (session[i] == 0 and k[i] <= self._first_k)):
                continue  # older than what is left of the plant's trace, and its answer
            for rule, text in self._unlike(message, int(session[i]), row, int(before[i])):
                yield Finding(rule, seen.session, seen.k, f"{seen.where}: {text}")

    def _unlike(
        self, message: Measurement | Offer, session: int, row: Any, before: int
    ) -> Iterator[tuple[str, str]]:
        """In what a message differs from step k, whose ``row`` may not be made yet."""
        lost = self._plant.may_lack(message.session, message.k)
        if session < 0:
            if message.session not in self._plant.announced and not lost:
                yield "wire", "of a session that the plant's trace does not have"
        elif row is None and before < 0:
            if not lost:
                yield "wire", f"step {message.k}, which the plant did not make"
        elif isinstance(message, Offer):
            yield from self._unlike_offer(message, session, row, before)
        else:
            yield from self._unlike_measurement(message, session, row, before)

    def _row_of(self, session: int, at: int) -> Any:
        """Row ``at``, where there is one and it is of this session."""
        inside = 0 <= at < len(self._rows) and self._rows[at]["session"] == session
        return self._rows[at] if inside else None

    def _unlike_measurement(
        self, m: Measurement, session: int, row: Any, before: int
    ) -> Iterator[tuple[str, str]]:
        newest = int(self._newest[before]) if before >= 0 else -1
        applied = self._row_of(session, newest)
        here = self._rows[before]["x_next"] if row is None else row["x"]
        other = " unlike the plant's trace"
        if not self._blurred and m.x != tuple(here.tolist()):
            yield "wire", f"x{other}"
        if m.applied_k != (-1 if applied is None else int(applied["k"])):
            yield "wire", f"applied_k{other}"
        elif applied is not None:
            if not self._blurred and m.x_after != tuple(applied["x_next"].tolist()):
                yield "wire", f"x_after{other}"
            if m.applied_copy and applied["counts"] & 1:
                yield "same-keys", "copy 1 of the offer was applied, and the plant counts copy 0"

    def _unlike_offer(
        self, offer: Offer, session: int, row: Any, before: int
    ) -> Iterator[tuple[str, str]]:
        """Of what was applied also the candidates; every offer carries its transition's symbol."""
        rules, k = self._e.rules, offer.k
        if row is not None and row["kind"] == TRANSITION:
            same = [list(u) for u in offer.candidates] == row["candidates"].tolist()
            if same and rules.predicted:
                same = [list(c) for c in offer.predictions] == row["predictions"].tolist()
            if not same and not self._blurred and not self._e.rewrites(k):
                yield "wire", "candidates unlike the plant's trace"
            if rules.scheme.from_stream and offer.cipher != row["cipher"]:
                yield "wire", "cipher unlike the plant's trace"
            if offer.heard and row["counts"] & 2:
                yield "same-keys", "copy 1 of the measurement was heard, the plant counts copy 0"
        if rules.scheme.from_stream:
            return
        at = before + 1  # of step k, or of the one after it
        following = int(self._next[at]) if at < len(self._next) else -1
        decided = self._row_of(session, following)
        if decided is None:
            expected = self._open.setdefault(offer.session, offer.cipher)
        else:
            expected = int(decided["cipher"])
        if offer.cipher != expected:
            yield "wire", f"cipher {offer.cipher}, decided was {expected}"


class Shapes:
    """What messages of one kind look like in each automaton state."""

    def __init__(self) -> None:
        self._looks: dict[tuple[str, bool], dict[Any, CapturedMessage]] = {}

    def take(self, seen: CapturedMessage, message: Measurement | Offer, carries: bool) -> None:
        """Take a message of a transition that carried, or tested."""
        if isinstance(message, Measurement) and message.applied_k == -1:
            return  # a session's first has no x_after yet, in state 1 always
        look = self._looks.setdefault((seen.topic, carries), {})
        look.setdefault(_shape(seen.raw), seen)

    def differ(self) -> Findings:
        """Looks that one state alone has."""
        for (topic, carries), look in self._looks.items():
            other = self._looks.get((topic, not carries))
            for shape, seen in look.items() if other is not None else ():
                if other is not None and shape not in other:
                    text = f"{topic} looks like this in state {1 + carries} only"
                    yield Finding("bus", seen.session, seen.k, f"{seen.where}: {text}")


def _shape(raw: bytes) -> tuple[bytes, int]:
    """A message's names, lengths and kinds of value: all that is left without digits.

    Of a nonce and a tag that is their length; which block was announced last and which digits an
    offer has follow from what was counted, and that is public.
    """
    keyless = _OF_KEYS.sub(lambda found: str(len(found[0])).translate(_AS_LETTERS).encode(), raw)
    keyless = _STREAM.sub(b"", _BLOCK.sub(b"", keyless, 1))
    return keyless.translate(None, _DIGITS), raw.count(b"[]")


class Seen:
    """What shows a second message of one number that differs, and what left twice."""

    def __init__(self, e: Evidence) -> None:
        self._keys, self._capture = e.rules.schedule is not None, e.capture
        self._first: dict[tuple[str, str], array[int]] = {}
        self._far: dict[tuple[str, str, int], int] = {}
        self._sessions: dict[str, int] = {}
        self._nonces, self._numbers = array("q"), array("q")

    def look(self, seen: CapturedMessage, message: Measurement | Offer) -> Findings:
        """Note a message."""
        blurred = self._capture is not None and self._capture.blurred
        if not blurred and not self._same(seen):
            text = f"{seen.where}: {seen.topic} {seen.k} differs from the first of that number"
            yield Finding("wire", seen.session, seen.k, text)
        if self._keys:
            session = self._sessions.setdefault(seen.session, len(self._sessions))
            offer, first = isinstance(message, Offer), message.copy_number == 0
            self._numbers.append(session << 34 | seen.k << 2 | offer << 1 | first)
            self._nonces.append(hash(message.nonce))

    def _same(self, seen: CapturedMessage) -> bool:
        """Whether a message is as the first of its number."""
        mine, k = hash(_ANEW.sub(b"", seen.raw, 1)) or 1, seen.k
        row = self._first.setdefault((seen.topic, seen.session), array("q"))
        if k >= len(row) + AT_ONCE:  # far ahead of the others
            return self._far.setdefault((seen.topic, seen.session, k), mine) == mine
        row.extend([0] * (k + 1 - len(row)))
        row[k] = row[k] or mine
        return row[k] == mine

    def twice(self) -> Findings:
        """Nonces that travelled twice, and second copies 0."""
        numbers: Indices = np.frombuffer(self._numbers, np.int64)
        nonces: Indices = np.frombuffer(self._nonces, np.int64)
        for values, among, text in (
            (nonces, slice(None), "carries a nonce that was there before"),
            (numbers, (numbers & 1).astype(bool), "is a second copy 0"),
        ):
            for number in numbers[among][_again(values[among])].tolist():
                session = list(self._sessions)[number >> 34]
                topic, k = "offer" if number & 2 else "measurement", number >> 2 & 0xFFFFFFFF
                yield Finding("once", session, k, f"{topic} {k} {text}")


def _again(values: Indices) -> Indices:
    """Places of values that stood at an earlier place."""
    ordered = np.sort(values)
    twice = ordered[1:][ordered[1:] == ordered[:-1]]
    places = np.flatnonzero(np.isin(values, twice)) if len(twice) else np.zeros(0, np.int64)
    first = np.unique(values[places], return_index=True)[1]
    return np.delete(places, first)


class Stream:
    """Positions in the key stream: each new offer names a later one."""

    def __init__(self, e: Evidence) -> None:
        self._digits = e.rules.digits
        self._named: dict[str, tuple[int, tuple[int, int]]] = {}

    def look(self, seen: CapturedMessage, message: Measurement | Offer) -> Findings:
        """Note a message."""
        if not self._digits or not isinstance(message, Offer):
            return
        if message.stream_block is None or message.stream_at is None:
            yield Finding(
                "once", seen.session, seen.k, f"{seen.where}: an offer without a position"
            )
            return
        at = message.stream_block, message.stream_at
        if at[0] < 0:
            return
        before, self._named[seen.session] = self._named.get(seen.session), (message.k, at)
        if before is None or before == (message.k, at):
            return
        k, (block, place) = before
        if k == message.k or (message.k > k and at < (block, place + self._digits)):
            text = f"{seen.where}: position {at}, and step {k} had {before[1]}"
            yield Finding("once", seen.session, seen.k, text)


class Tags:
    """Each end shows one tag for a block, and the same as its partner; and what counts is named."""

    def __init__(self, e: Evidence) -> None:
        self._known: dict[tuple[str, str, int], str] = {}
        self._e, self._claimed = e, e.rules.schedule is not None

    def look(self, seen: CapturedMessage, message: Measurement | Offer) -> Findings:
        """Note a message."""
        if not self._claimed:
            if message.nonce or message.tag:
                text = f"{seen.where}: a nonce or a tag, and no key is claimed"
                yield Finding("blocks", seen.session, seen.k, text)
        elif message.block >= 0:
            at = seen.topic, seen.session, message.block
            if self._known.setdefault(at, message.tag) != message.tag:
                text = f"{seen.where}: block {message.block} has another tag than before"
                yield Finding("same-keys", seen.session, seen.k, text)

    def differ(self) -> Findings:
        """Blocks of which the ends have shown different tags."""
        for (topic, session, block), tag in self._known.items():
            if topic == "measurement" and self._known.get(("offer", session, block), tag) != tag:
                yield Finding("same-keys", session, -1, f"block {block}: the ends' tags differ")
