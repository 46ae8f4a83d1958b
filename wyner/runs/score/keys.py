"""What the tap of a run holds of its keys, from both ends' traces and the capture.

The claim is the operator's; a run can refute it, and never prove it. What she missed is exact here:
her capture is all that she heard, and which copies counted stands in the plant's trace.
"""

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from protocol.scenario import Scenario
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import NONCE_BYTES
from protocol.statistics import COUNTED, POOLED
from runtime.recording import TraceError
from tap_service.capture.reading import CaptureError
from tap_service.inference.key_solver import bits_held
from tap_service.inference.miss_rate import ALL, AWAY, Audit, MissRate
from wyner.runs.resolve import Event
from wyner.runs.run import Run
from wyner.runs.score.by_step import BySteps

KEY_BITS: Final = 8 * NONCE_BYTES

Copy = tuple[str, str, int]
"""A copy 0: which message (``offer``, ``measurement``), session and step."""

_TOPICS: Final = ("measurement", "offer")


class AuditedBlock(NamedTuple):
    """A key block beside what the tap heard of it.

    ``missed`` counts copies that counted and that she did not hear; ``held_bits`` is what she can
    compute of the block's rows. Both are None where nobody listened. ``lost`` is L, the copies that
    did not count.
    """

    session: str
    number: int
    transitions: int
    steps: int
    counted: int
    rows: int
    keys: int
    missed: int | None
    held_bits: int | None
    confirmed: bool
    last_k: int
    lost: int


class Copies:
    """Copies 0 in their order, in eight bytes each: a run has millions."""

    def __init__(self) -> None:
        self._sessions: dict[str, int] = {}
        self._codes = array("q")

    def add(self, *copies: Copy) -> None:
        """Append copies."""
        for topic, session, k in copies:
            place = self._sessions.setdefault(session, len(self._sessions))
            self._codes.append(k << 24 | place << 1 | (topic == "offer"))

    def __len__(self) -> int:
        return len(self._codes)

    def __iter__(self) -> Iterator[Copy]:
        sessions = list(self._sessions)
        for code in self._codes:
            yield _TOPICS[code & 1], sessions[code >> 1 & 0x7FFFFF], code >> 24


class HeardCopies:
    """Copies 0 that a tap has heard, each with the number of her recording."""

    def __init__(self) -> None:
        self._incarnations = {topic: BySteps() for topic in _TOPICS}

    def add(self, copy: Copy, incarnation: int) -> None:
        """Note a copy, the first time."""
        topic, session, k = copy
        if (heard := self._incarnations.get(topic)) is not None:
            heard.setdefault((session, k), incarnation)

    def incarnation(self, copy: Copy) -> int | None:
        """In which of her recordings a copy is; None where she missed it."""
        topic, session, k = copy
        found: int | None = self._incarnations[topic].get((session, k))
        return found


@dataclass(slots=True)
class _Block:
    transitions: int = 0
    steps: int = 0
    last_k: int = -1
    copies: Copies = field(default_factory=Copies)


class _Leaving:
    """How often the messages of one end left, from the events of its trace."""

    def __init__(self) -> None:
        self._at: dict[str | None, list[tuple[int, int]]] = {}
        self._times = 1

    def take(self, event: Event) -> None:
        """Take the next event."""
        if event["event"] in ("appearances", "session"):
            self._times = event.get("times", self._times)
            self._at.setdefault(event["session"], []).append((event.get("k", -1), self._times))

    def times(self, session: str, k: int) -> int | None:
        """Of the message of step k; None where that changed just then."""
        times = None
        for at, count in self._at.get(session, ()):
            if abs(at - k) <= 1 and times not in (None, count):
                return None
            if at <= k:
                times = count
        return 1 if times is None else times


@dataclass(slots=True)
class _Walk:
    """The blocks of a run, and every copy 0 that was sent, from the plant's trace."""

    schedule: Schedule
    blocks: dict[tuple[str, int], _Block] = field(default_factory=dict)
    sent: Copies = field(default_factory=Copies)
    keys: dict[tuple[str, int], int] = field(default_factory=dict)
    steps: int = 0
    _last_k: dict[str, int] = field(default_factory=dict)

    def take(self, event: Event) -> None:
        """Take the next event of the trace."""
        kind = event["event"]
        if kind == "missed":
            self.steps += 1
            self.sent.add(("measurement", event["session"], event["k"]))
        elif kind == "transition":
            self._transition(event)
        elif kind == "block" and event["what"] == "confirmed":
            self.keys[event["session"], event["number"]] = event["keys"]

    def _transition(self, event: dict[str, Any]) -> None:
        session, j, k = event["session"], event["j"], event["k"]
        before = self._last_k.get(session, k)
        self._last_k[session] = k
        self.steps += 1
        both: tuple[Copy, Copy] = (("measurement", session, k), ("offer", session, k))
        self.sent.add(*both)
        number = self.schedule.block_of(j)
        if number < 0:
            return
        block = self.blocks.setdefault((session, number), _Block())
        block.transitions += 1
        block.steps += k - before
        block.last_k = k
        counts = self.schedule.assumption.counting(event["counts"])
        block.copies.add(*[both[1]] * (counts & 1), *[both[0]] * (counts >> 1))


@dataclass(frozen=True, slots=True)
class KeyAudit:
    """A run's keys, and what its tap holds of them.

    Parameters
    ----------
    claim : float
        eps_E.
    sentence : str
        Under which claim the keys are secret, in words.
    refused : str or None
        Why none is made.
    blocks : tuple of AuditedBlock
    rates : mapping of str to MissRate
        Her misses of copies 0 while she was there, each direction by itself, and in it each number
        of times that messages left; empty where nothing was captured.
    seconds : float
        Plant time.
    period_s : float
    listened : bool
        Whether there is a capture: without one nothing is known of what a tap would hold.
    unread : tuple of str
        Traces that cannot be read to their end, and why: blocks after that are not counted.
    """

    claim: float
    sentence: str
    refused: str | None
    blocks: tuple[AuditedBlock, ...]
    rates: Mapping[str, MissRate]
    seconds: float
    period_s: float
    listened: bool = True
    unread: tuple[str, ...] = ()

    @property
    def made(self) -> int:
        """Keys of blocks that the partner has confirmed."""
        return sum(block.keys for block in self.blocks if block.confirmed)

    @property
    def held_bits(self) -> int:
        """Bits that the tap holds of blocks that made keys; 0 where nobody listened."""
        return sum(block.held_bits or 0 for block in self.blocks if block.keys)

    @property
    def missed(self) -> float | None:
        """Share of copies 0 that she missed while she was there; None where she never was."""
        classes = [rate for name, rate in self.rates.items() if name != ALL]
        copies = sum(rate.copies for rate in classes)
        return sum(rate.missed for rate in classes) / copies if copies else None

    @property
    def first_key_s(self) -> float | None:
        """Plant time at which the first key's block was over."""
        made = [block for block in self.blocks if block.keys]
        return (made[0].last_k + 1) * self.period_s if made else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What must be told in red."""
        found = [f"counted up to there: {why}" for why in self.unread]
        if self.held_bits:
            broken = sum(bool(block.held_bits) and block.keys > 0 for block in self.blocks)
            found.append(f"she holds {self.held_bits} bits, of {broken} blocks")
        for name, rate in self.rates.items():
            if rate.refuted:
                found.append(
                    f"she misses {rate.high:.3g} of the {name} at most, and eps_E = "
                    f"{self.claim:g} was claimed: refuted"
                )
            if rate.bursts:
                found.append(f"her misses of {name} come in bursts ({rate.lag} copies apart)")
            if not rate.copies and rate.absent and name != ALL:
                found.append(f"she was not there: of {rate.absent} {name} she heard one at most")
        return tuple(found)

    def as_json(self, *, blocks: bool = False) -> dict[str, Any]:
        """The object ``keys`` of ``wyner up --json``; with ``blocks``, each of them instead of how
        many there are.
        """
        made = [block for block in self.blocks if block.keys and block.confirmed]
        last = made[-1] if made else None
        return {
            "made": self.made,
            "bits_per_second": KEY_BITS * self.made / self.seconds if self.seconds else 0.0,
            "last_block_bits_per_second": 0.0
            if last is None
            else KEY_BITS * last.keys / (last.steps * self.period_s),
            "first_key_s": self.first_key_s,
            "listened": self.listened,
            "held_by_tap_bits": self.held_bits if self.listened else None,
            "refused": self.refused,
            "blocks": [block._asdict() for block in self.blocks] if blocks else len(self.blocks),
            "missed_by_tap": self.missed,
            "no_interval": {
                "bits_per_second": COUNTED,
                "last_block_bits_per_second": COUNTED,
                "missed_by_tap": POOLED,
            },
            "audited": {name: rate._asdict() for name, rate in self.rates.items()},
            "assumption": self.sentence,
            "warnings": list(self.warnings),
        }


def key_lines(keys: dict[str, Any]) -> list[str]:
    """What :meth:`KeyAudit.as_json` says, for people; the first line is the verdict."""
    refused = keys["refused"]
    if refused is not None and not keys["blocks"]:
        return [f"Keys       none: {refused}"]
    held = "Nobody listened: what Eve would hold is not known."
    if keys["listened"]:
        held = f"Eve holds {keys['held_by_tap_bits']} bits of their blocks."
    made = f"{keys['made']} {'key' if keys['made'] == 1 else 'keys'}"
    lines = [
        f"Keys       {made} of {KEY_BITS} bits, {keys['bits_per_second']:.0f} bit/s, "
        f"counted. {held}",
        f"           {keys['assumption']}",
    ]
    if refused is not None:
        lines.append(f"           refused: {refused}")
    return lines + [f"           WARNING: {text}" for text in keys["warnings"]]


def audit_keys(run: Run, scenario: Scenario) -> KeyAudit | None:
    """What the tap of a run holds of its keys; None where the scenario has no table ``keys``."""
    if scenario.keys is None:
        return None
    claim = scenario.keys.assumption()
    schedule = scenario.keys.schedule()
    refused = scenario.keys.refusal()
    if schedule is None:
        rates: dict[str, MissRate] = {}
        nothing = (claim.sentence(), refused, (), rates, 0.0, scenario.plant.period_s)
        return KeyAudit(claim.eps_E, *nothing)
    walk, behind = _Walk(schedule), 0
    leaving = {"measurement": _Leaving(), "offer": _Leaving()}
    unread = []
    try:
        behind = run.feed("plant", walk.take, leaving["measurement"].take)
    except TraceError as error:
        unread.append(str(error))
    try:
        run.feed("controller", leaving["offer"].take)
    except TraceError as error:
        unread.append(str(error))
    heard = _heard(run)
    blocks = tuple(
        _audited(walk, at, block, heard)
        for at, block in walk.blocks.items()
        if block.transitions == schedule.length(at[1])
    )
    rates = {} if heard is None else _rates(run, claim, walk.sent, heard, leaving)
    return KeyAudit(
        claim.eps_E,
        claim.sentence(),
        refused,
        blocks,
        rates,
        (walk.steps + behind) * scenario.plant.period_s,
        scenario.plant.period_s,
        heard is not None,
        tuple(unread),
    )


def _rates(
    run: Run, claim: Assumption, sent: Copies, heard: HeardCopies, leaving: Mapping[str, _Leaving]
) -> dict[str, MissRate]:
    """Her misses by class: direction, and how often the message left.

    What left more often than the claim states was no copy 0, and what left just then may have been
    none; neither is counted. She was not there before she heard anything, between two of her
    recordings, and after the last copy that she heard, where :data:`AWAY` or more followed. Her
    capture's header says how many of a message's appearances reach her: 1, by her own link.
    """
    hears = run.capture().header.get("appearances", 1)

    def copies() -> Iterator[tuple[str, Copy]]:
        for copy in sent:
            name = f"{copy[0]}s"
            times = leaving[copy[0]].times(*copy[1:])
            if claim.directions not in ("both", name) or times is None or times > claim.appearances:
                continue
            yield (name if times == 1 else f"{name} that left {times} times"), copy

    names: dict[str, None] = {}
    last: dict[int, int] = {}  # of each of her recordings, the last copy in it
    count = 0
    for name, copy in copies():
        names.setdefault(name)
        if (incarnation := heard.incarnation(copy)) is not None:
            last[incarnation] = count
        count += 1
    ends = {i for i in last.values() if i < max(last.values()) or count - i > AWAY}
    audit = Audit(claim.eps_E**hears, tuple(names))
    for i, (name, copy) in enumerate(copies()):
        audit.add(name, missed=heard.incarnation(copy) is None)
        if i in ends:
            audit.gone()
    return audit.judge()


def _audited(
    walk: _Walk, at: tuple[str, int], block: _Block, heard: HeardCopies | None
) -> AuditedBlock:
    a = walk.schedule.assumption
    rows = a.rows(block.transitions, block.steps, len(block.copies))
    missed = held = None
    if heard is not None:
        missed = sum(heard.incarnation(copy) is None for copy in block.copies)
        held = bits_held(rows, missed) if rows >= 2 else 0
    return AuditedBlock(
        *at,
        transitions=block.transitions,
        steps=block.steps,
        counted=len(block.copies),
        rows=rows,
        keys=walk.keys.get(at, 0),
        missed=missed,
        held_bits=held,
        confirmed=at in walk.keys,
        last_k=block.last_k,
        lost=a.copies * block.steps - len(block.copies),
    )


def _heard(run: Run) -> HeardCopies | None:
    """Every copy 0 in the capture, with the number of her recording; None where there is none."""
    heard = HeardCopies()
    try:
        reader = run.capture()
        for _, message in reader.records():
            if not message.copy_number:
                copy = (message.topic, message.session, message.k)
                heard.add(copy, reader.incarnations)
    except (CaptureError, OSError):
        return None
    return heard
