"""Whoever is woken when it asked to be asks next for a later time, or its host would spin."""

import random

from protocol.messages import ControllerHello
from tests.support.journals import plant_journal
from tests.support.line import line_plant, line_rules

RULES = line_rules(alpha=4.0, largest_input=1e9)
PARTNER = "c" * 16


def test_a_plant_whose_partner_falls_silent_never_asks_for_the_same_instant_again() -> None:
    draw = random.Random(1)
    for _ in range(300):  # the sum answered + silence rounds, now and then below their difference
        now = draw.random() * 3
        plant, _ = line_plant(RULES, plant_journal(), lambda: "5" * 16, "b" * 16, now, None)
        tuple(plant.start(now))
        hello = ControllerHello(
            instance=PARTNER,
            incarnation=1,
            fingerprint=RULES.fingerprint,
            verdict="greeting",
            session=None,
            answers=None,
        )
        tuple(plant.receive(ControllerHello, hello.wire(), now))
        accepted = hello.model_copy(
            update={"verdict": "accepted", "session": "5" * 16, "answers": "b" * 16}
        )
        tuple(plant.receive(ControllerHello, accepted.wire(), now))
        assert plant.state.session.accepted
        until = now + 2.5
        while now < until:
            now = max(now, plant.wake_at())
            tuple(plant.wake(now))
            assert plant.wake_at() > now
