"""``wyner send``: what it says on the bus while it waits."""

import time
from collections.abc import Callable
from typing import Any

from protocol.messages import SealCommand, SealReply
from wyner.cli.send import REPEAT_S, _answers


class CrowdedBus:
    """A bus on which each command brings answers to many others too."""

    def __init__(self, others: int) -> None:
        self.others = others
        self.said = 0
        self.hear: Callable[[str, bytes, int], None]

    def subscribe(self, _key: str, handler: Callable[[str, bytes, int], None]) -> None:
        self.hear = handler

    def publisher(self, _key: str) -> "CrowdedBus":
        return self

    def put(self, payload: bytes) -> None:
        self.said += 1
        mine = SealCommand.model_validate_json(payload).id
        for name in (*(f"other-{i}" for i in range(self.others)), mine):
            reply = SealReply(id=name, accepted=True, delivered=False, detail="queued")
            self.hear("", reply.wire(), 0)


def test_answers_to_others_are_no_reason_to_say_it_again() -> None:
    """Where each answer made every operator ask again, five of them flooded the controller."""
    bus: Any = CrowdedBus(others=50)
    begun = time.monotonic()
    answers = list(_answers(bus, "loop", SealCommand(id="mine", payload=b"x"), begun + 0.45))
    took = time.monotonic() - begun
    assert 1 <= bus.said <= took / REPEAT_S + 1
    assert len(answers) == bus.said
    assert {reply.id for reply in answers} == {"mine"}
