"""What the tap of a run holds of its keys, from both ends' traces and the capture.

The claim is the operator's; a run can refute it, and never prove it. What she missed is exact here:
her capture is all that she heard, and which copies counted stands in the plant's trace.
"""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np

from protocol.link.key_events import Appearances
from protocol.scenario import Scenario
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import NONCE_BYTES
from protocol.statistics import COUNTED, POOLED
from tap_service.capture.reading import CaptureError
from tap_service.eavesdroppers.key_solver import bits_held
from tap_service.inference.miss_rate import ALL, AWAY, Audit, MissRate
from wyner.runs.blocks import Blocks, TracedBlock, ended
from wyner.runs.lines import INTERRUPTED, MISSED
from wyner.runs.run import Run
from wyner.runs.trace import AT_ONCE, Places, Trace

KEY_BITS: Final = 8 * NONCE_BYTES

_TOPICS: Final = ("measurement", "offer")


Heard = Mapping[str, np.ndarray[Any, np.dtype[np.int16]]]
"""By topic, of each step of the plant: the number of the recording in which Eve heard its copy 0,
-1 where she missed it."""


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


class _Leaving:
    """How often the messages of one end left, from its trace."""

    def __init__(self, trace: Trace | None) -> None:
        self._at: dict[str | None, list[tuple[int, int]]] = {}
        times = 1
        for told in () if trace is None else trace.told("appearances", "session"):
            line, k = told.line, -1
            if isinstance(line, Appearances):
                times, k = line.times, line.k
            self._at.setdefault(getattr(line, "session", None), []).append((k, times))

    def times(self, session: str, k: int) -> int | None:
        """Of the message of step k; None where that changed just then."""
        times = None
        for at, count in self._at.get(session, ()):
            if abs(at - k) <= 1 and times not in (None, count):
                return None
            if at <= k:
                times = count
        return 1 if times is None else times


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
    period_s : float
    blocks : tuple of AuditedBlock
    rates : mapping of str to MissRate
        Her misses of copies 0 while she was there, each direction by itself, and in it each number
        of times that messages left; empty where nothing was captured.
    steps : int
        The plant's.
    listened : bool
        Whether there is a capture: without one nothing is known of what a tap would hold.
    unread : tuple of str
        Traces that cannot be read to their end, and why: blocks after that are not counted.
    """

    claim: float
    sentence: str
    refused: str | None
    period_s: float
    blocks: tuple[AuditedBlock, ...] = ()
    rates: Mapping[str, MissRate] = field(default_factory=dict)
    steps: int = 0
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
            found.append(f"Eve holds {self.held_bits} bits, of {broken} blocks")
        for name, rate in self.rates.items():
            if rate.refuted:
                found.append(
                    f"Eve misses {rate.high:.3g} of the {name} at most, and eps_E = "
                    f"{self.claim:g} was claimed: refuted"
                )
            if rate.bursts:
                found.append(f"Eve's misses of {name} come in bursts ({rate.lag} copies apart)")
            if not rate.copies and rate.absent and name != ALL:
                found.append(f"Eve was not there: of {rate.absent} {name} Eve heard one at most")
        return tuple(found)

    def __str__(self) -> str:
        """A row for each key block, and what follows from them."""
        lines = []
        if self.blocks:
            lines.append("block  transitions  lost  rows  keys  Eve missed  Eve holds, bit")
        for b in self.blocks:
            missed = "-" if b.missed is None else b.missed
            held = "-" if b.held_bits is None else b.held_bits
            lines.append(
                f"{b.number:5}  {b.transitions:11}  {b.lost:4}  {b.rows:4}  {b.keys:4}  "
                f"{missed:>10}  {held if b.keys else 0:>14}"
            )
        return "\n".join([*lines, *key_lines(self.as_json())])

    def as_json(self, *, blocks: bool = False) -> dict[str, Any]:
        """The object ``keys`` of ``wyner up --json``; with ``blocks``, each of them instead of how
        many there are.
        """
        made = [block for block in self.blocks if block.keys and block.confirmed]
        last = made[-1] if made else None
        seconds = self.steps * self.period_s
        return {
            "made": self.made,
            "bits_per_second": KEY_BITS * self.made / seconds if seconds else 0.0,
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
    claim, schedule = scenario.keys.assumption(), scenario.keys.schedule()
    found = KeyAudit(
        claim.eps_E, claim.sentence(), scenario.keys.refusal(), scenario.plant.period_s
    )
    if schedule is None:
        return found
    unread: list[str] = []
    plant, controller = run.so_far("plant", unread), run.so_far("controller", unread)
    if plant is None:
        return replace(found, listened=False, unread=tuple(unread))
    heard = _heard(run, plant)
    keys = {(b.session, b.number): b.keys for b in ended(plant) if b.what == "confirmed"}
    leaving = {"measurement": _Leaving(plant), "offer": _Leaving(controller)}
    return replace(
        found,
        blocks=tuple(_audited(schedule, b, plant, keys, heard) for b in Blocks(schedule, plant)),
        rates={} if heard is None else _rates(run, claim, plant, heard, leaving),
        steps=plant.behind + int((plant.steps["kind"] != INTERRUPTED).sum()),
        listened=heard is not None,
        unread=tuple(unread),
    )


def _rates(
    run: Run, claim: Assumption, plant: Trace, heard: Heard, leaving: Mapping[str, _Leaving]
) -> dict[str, MissRate]:
    """Her misses by class: direction, and how often the message left.

    What left more often than the claim states was no copy 0, and what left just then may have been
    none; neither is counted. She was not there before she heard anything, between two of her
    recordings, and after the last copy that she heard, where :data:`AWAY` or more followed. Her
    capture's header says how many of a message's appearances reach her: 1, by her own link.
    """
    names: dict[str, int] = {}
    classes, recordings = array("b"), array("h")  # of each copy 0 that was sent
    for first in range(0, len(plant.steps), AT_ONCE):
        rows = plant.steps[first : first + AT_ONCE]
        columns = [rows[name].tolist() for name in ("session", "k", "kind")]
        columns += [heard[topic][first : first + len(rows)].tolist() for topic in _TOPICS]
        for number, k, kind, *recorded in zip(*columns, strict=True):
            for topic, recording in zip(_TOPICS, recorded, strict=True):
                if kind == INTERRUPTED or (kind == MISSED and topic == "offer"):
                    continue
                times = leaving[topic].times(plant.sessions[number], k)
                other = claim.directions not in ("both", name := f"{topic}s")
                if other or times is None or times > claim.appearances:
                    continue
                name = name if times == 1 else f"{name} that left {times} times"
                classes.append(names.setdefault(name, len(names)))
                recordings.append(recording)
    last = {recording: i for i, recording in enumerate(recordings) if recording >= 0}
    gone = {i for i in last.values() if i < max(last.values()) or len(recordings) - i > AWAY}
    by_number = [*names]
    audit = Audit(claim.eps_E ** run.capture().header.get("appearances", 1), by_number)
    for i, (number, recording) in enumerate(zip(classes, recordings, strict=True)):
        audit.add(by_number[number], missed=recording < 0)
        if i in gone:
            audit.gone()
    return audit.judge()


def _audited(
    schedule: Schedule,
    block: TracedBlock,
    plant: Trace,
    keys: Mapping[tuple[str, int], int],
    heard: Heard | None,
) -> AuditedBlock:
    at, rows = (block.session, block.number), block.secret_rows(schedule)
    missed = held = None
    if heard is not None:
        unheard = {topic: heard[topic][block.rows] < 0 for topic in _TOPICS}
        missed = int((unheard["offer"] & (block.counts & 1 > 0)).sum())
        missed += int((unheard["measurement"] & (block.counts >> 1 > 0)).sum())
        held = bits_held(rows, missed) if rows >= 2 else 0
    return AuditedBlock(
        *at,
        transitions=len(block.rows),
        steps=block.steps,
        counted=block.counted,
        rows=rows,
        keys=keys.get(at, 0),
        missed=missed,
        held_bits=held,
        confirmed=at in keys,
        last_k=int(plant.rows["k"][block.rows[-1]]),
        lost=schedule.assumption.copies * block.steps - block.counted,
    )


def _heard(run: Run, plant: Trace) -> Heard | None:
    """Every copy 0 of the plant's steps in the capture; None where there is no capture."""
    places = Places(plant)
    heard = {topic: np.full(len(plant.rows), -1, np.int16) for topic in _TOPICS}
    try:
        reader = run.capture()
        for _, message in reader.records():
            place = -1 if message.copy_number else places.of(message.session, message.k)
            if place >= 0 and heard[message.topic][place] < 0:
                heard[message.topic][place] = reader.incarnations
    except (CaptureError, OSError):
        return None
    return heard
