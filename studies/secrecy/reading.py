"""The reading study: whole messages, read by one who hears badly, and how sure she was."""

import hashlib
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from studies.registry import study
from studies.secrecy.runs import simulate, text_of
from studies.secrecy.sentences import SENTENCES
from studies.secrecy.study import (
    STATED,
    described,
    heard_by,
    offline,
    output_about,
    stated_by,
)
from studies.secrecy.study import VIEWS as ALL_VIEWS
from tap_service.capture.channel import View
from tap_service.eavesdroppers import named
from tap_service.eavesdroppers.base import Eavesdropper
from tap_service.eavesdroppers.text import Text
from tap_service.inference.expectation import any_bytes
from wyner.runs.score.score import score

RUNS: Final = 30
"""Seeds of a condition of `packed`."""

FEW: Final = 20
"""Seeds of a condition of `sustained`."""

FIRST_SEED: Final = 1000

SOME: Final = 5
"""Seeds of a condition that states no target."""

RANDOM_BYTES: Final = {"packed": 24, "sustained": 8}
"""Bytes of a message that is no text, by scenario."""

ANY_BYTES: Final = "text, any bytes"
"""`text`, who expects no language: beside her on messages that have none."""

COLUMNS: Final = (
    "condition tap seed steps keys keys_right bits bits_right messages messages_exact" + STATED
)


@dataclass(frozen=True, slots=True)
class Reading:
    """One run before one eavesdropper."""

    condition: str
    tap: str
    seed: int
    scenario: str = "packed"
    steps: int = 320
    view: View = field(default_factory=View)
    payload: str = "sentence"

    @property
    def id(self) -> str:
        """A hash of what is measured and how."""
        parts = (self.condition, self.tap, self.seed, self.scenario, self.steps, self.payload)
        return hashlib.sha256(f"{parts!r} {described(self.view)}".encode()).hexdigest()[:12]


PACKED: Final[dict[str, dict[str, Any]]] = {
    "packed, loss 30 %": {"loss": 0.3},
    "packed, offers only": {"view": "offers"},
    "packed, noise 0.05": {"noise": 0.05},
    "packed, loss 50 %": {"loss": 0.5},
    "packed, measurements only": {"view": "measurements"},
}

SUSTAINED: Final[dict[str, dict[str, Any]]] = {
    "sustained, loss 10 %": {"loss": 0.1},
    "sustained, loss 30 %": {"loss": 0.3},
}

VIEWS: Final = {name: knobs for name, knobs in ALL_VIEWS.items() if name != "measurements only"}
"""Every view in which ciphertext is heard."""

LONG: Final[dict[str, dict[str, Any]]] = {
    "packed, 600 steps, loss 10 %": {"loss": 0.1},
    "packed, 600 steps, loss 30 %": {"loss": 0.3},
    "packed, 600 steps, noise 0.05": {"noise": 0.05},
}
"""The rows of docs/findings.md."""

OTHERS: Final = ("packed-double-integrator", "packed-quadruple-tank", "packed-batch-reactor")


def readings(taps: Sequence[str] = ("text", "smoother")) -> Iterator[Reading]:
    """The whole study, the same captures before every tap."""
    for tap in taps:
        for i in range(RUNS):
            seed = FIRST_SEED + i
            for condition, knobs in PACKED.items():
                yield Reading(condition, tap, seed, view=View(seed=seed, **knobs))
            if i < FEW:
                for condition, knobs in SUSTAINED.items():
                    view = View(seed=seed, **knobs)
                    yield Reading(condition, tap, seed, "sustained", 1000, view, "short")
            if i < FEW // 2:
                view = View(seed=seed, loss=0.3)
                name = "packed, random bytes, loss 30 %"
                yield Reading(name, tap, seed, view=view, payload="bytes")
                if tap == Text.name:
                    yield Reading(name, ANY_BYTES, seed, view=view, payload="bytes")
                for condition, knobs in LONG.items():
                    view = View(seed=seed, **knobs)
                    yield Reading(condition, tap, seed, steps=600, view=view)
            for view_name, knobs in VIEWS.items() if i < SOME else ():
                view = View(seed=seed, **knobs)
                name = f"packed, {view_name}"
                if name not in PACKED:
                    yield Reading(name, tap, seed, view=view)
                if view_name != "loss 30 %":
                    name = f"packed, random bytes, {view_name}"
                    yield Reading(name, tap, seed, view=view, payload="bytes")
                name = f"sustained, random bytes, {view_name}"
                yield Reading(name, tap, seed, "sustained", 1000, view, "bytes")
            for name in OTHERS if i < SOME else ():
                view = View(seed=seed, loss=0.3)
                yield Reading(f"{name}, loss 30 %", tap, seed, name, view=view)


def payload_of(reading: Reading) -> bytes:
    """Its message, by its seed."""
    rng = random.Random(f"reading {reading.scenario} {reading.payload} {reading.seed}")
    if reading.payload == "bytes":
        return rng.randbytes(RANDOM_BYTES[reading.scenario])
    if reading.payload == "short":
        return text_of(rng)
    return SENTENCES[(reading.seed - FIRST_SEED) % len(SENTENCES)].encode("ascii")


@study("secrecy-reading", COLUMNS, readings)
def measure(reading: Reading) -> Iterator[dict[str, object]]:
    """One row."""
    payload = payload_of(reading)
    run = simulate(reading.steps, reading.seed, name=reading.scenario, payloads=[payload])
    knowledge = reading.view.knowledge(run.scenario.knowledge())
    begun = time.process_time()
    if reading.tap == ANY_BYTES:
        tap: Eavesdropper = Text(knowledge, any_bytes(), live=False)
    else:
        tap = offline(named(reading.tap), knowledge)
    said = output_about(tap, heard_by(run, reading.view))
    scored = score(run.truth, said)
    yield {
        "condition": reading.condition,
        "tap": reading.tap,
        "seed": reading.seed,
        "steps": reading.steps,
        "keys": scored.keys.of,
        "keys_right": f"{scored.keys_reviewed.right:g}",
        "bits": scored.bits.of,
        "bits_right": f"{scored.bits.right:g}",
        "messages": scored.messages.of,
        "messages_exact": int(scored.messages.right),
        **stated_by(said.belief, payload, begun),
    }
