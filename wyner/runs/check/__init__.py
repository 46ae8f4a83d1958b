"""Does a run obey the paper? A list of checks, each of which looks at the evidence.

A check counts what it looked at and keeps the first place where it did not hold. There are three
kinds. A replay evaluates the pure functions of both ends (:mod:`protocol.agreement`, the scheme,
:mod:`protocol.schemes.framing`) on the raw numbers of the traces: it finds a trace that its program
did not write. Others compare files with each other. The check ``paper`` asks code that shares
nothing with the ends (:mod:`wyner.runs.check.paper`): it finds a program that is wrong.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from wyner.runs.check.base import Check, Counter, Result
from wyner.runs.check.bus import PublicFields, SameAnswer, SameShape, Wire
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.files import ScenarioIdentity, Traces, Whole
from wyner.runs.check.key_blocks import (
    Blocks,
    Copy0Once,
    Counted,
    NonceOnce,
    RefusedAtZero,
    Tags,
)
from wyner.runs.check.keys import Agreement, Coin, InStep, Paper, Receiver, Sender
from wyner.runs.check.loop import Admissible, Reachable, Switching
from wyner.runs.check.message import Frames, Messages, OneCipher, OneTimePad, Prefix
from wyner.runs.check.watched import Alarms, KeyStream

CHECKS: Final[tuple[type[Check], ...]] = (
    Traces,
    ScenarioIdentity,
    Whole,
    Switching,
    Reachable,
    Admissible,
    Agreement,
    Coin,
    Sender,
    Receiver,
    Paper,
    InStep,
    Prefix,
    Frames,
    Messages,
    OneTimePad,
    OneCipher,
    SameAnswer,
    Wire,
    PublicFields,
    SameShape,
    NonceOnce,
    Copy0Once,
    Counted,
    Blocks,
    Tags,
    RefusedAtZero,
    KeyStream,
    Alarms,
)

OF_KEYS: Final = frozenset(
    kind.name
    for kind in (
        NonceOnce,
        Copy0Once,
        Counted,
        Blocks,
        Tags,
        KeyStream,
    )
)
"""Checks of which a scenario that makes no keys knows nothing."""


def check(evidence: Evidence, watch: Callable[[Part], None] | None = None) -> list[Result]:
    """Make every check, in one passage over the run; ``watch`` is shown each part as well."""
    keys = evidence.rules.schedule is not None
    results: list[Result] = []
    checks: list[Check] = []
    for kind in CHECKS:
        if not keys and kind.name in OF_KEYS:
            continue
        counter = Counter(skipped=kind.skipped(evidence))
        results.append(Result(kind, counter))
        if not counter.skipped:
            checks.append(kind(evidence, counter))
    with _collecting_seldom():
        for part in evidence.parts():
            for one in checks:
                one.feed(part)
            if watch is not None:
                watch(part)
    for one in checks:
        one.finish()
    return results


@contextmanager
def _collecting_seldom() -> Iterator[None]:
    """Let Python look for cycles once in several parts: a part is thousands of tuples without any.

    Looking at them after every 700 takes a sixth of a check.
    """
    threshold = gc.get_threshold()
    gc.set_threshold(200_000, *threshold[1:])
    try:
        yield
    finally:
        gc.set_threshold(*threshold)
