"""A check that judges parts made by hand."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from wyner.runs.check.base import Check, Counter
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Evidence, Part

SCHEDULE = Schedule(Assumption(eps_E=0.9, eps_sec=0.3), first=4, largest=8)
"""Blocks of 4, 8, 8, ... transitions; a weak claim, so that so few make keys."""


def evidence(
    folder: Path = Path(), /, *, schedule: Schedule | None = SCHEDULE, **other: Any
) -> Evidence:
    cut = other.pop("cut", None)
    readers = [(side, SimpleNamespace(cut=cut)) for side in ("plant", "controller")]
    there = {"wire": 1, "plant": 1, "controller": 1, "manifest": {}, "keys": 1, **other}
    return cast(
        Evidence,
        SimpleNamespace(
            run_dir=folder,
            rules=SimpleNamespace(schedule=schedule),
            scenario=SimpleNamespace(keys=there.pop("keys")),
            readers=lambda: iter(readers),
            before=lambda seen: seen.part == "too-old.jsonl",
            **there,
        ),
    )


def judge(kind: type[Check], e: Evidence, *parts: Part) -> Counter:
    """What a check counts over these parts."""
    counter = Counter(skipped=kind.skipped(e))
    if not counter.skipped:
        judging = kind(e, counter)
        for part in parts:
            judging.feed(part)
        judging.finish()
    return counter


def heard(*seen: CapturedMessage) -> Part:
    return Part([], [], [], list(seen))
