"""The box at both ends where one output alone is read: moved by steps that are made and missed."""

from protocol.box_observer import Estimate
from protocol.link.effects import Tell
from protocol.link.events import Event, Missed
from protocol.link.session import rules_of
from tests.support.recorded_pair import law_of
from wyner.simulate.faults import Faults
from wyner.simulate.network import Simulation


def test_both_ends_move_one_box_through_steps_that_are_made_and_missed() -> None:
    """And a plant whose own state is known keeps it, which no reading tells."""
    scenario, law = law_of("encoder")
    world = Simulation(scenario, law, seed=3, faults=Faults(loss=0.3), step_s=0.02)
    history = world.run(steps=300)
    assert history.missed > 20
    rule = rules_of(scenario).outputs
    assert rule is not None
    box: Estimate | None = None
    k = -1
    for at, t in history.plant.items():
        expected = rule.box(box, t.k - k - 1, t.x)
        assert t.verdict.box == expected
        assert t.verdict == rule.judge(expected, t.candidates, t.x_next)
        assert at not in history.controller or history.controller[at].verdict == t.verdict
        box, k = t.verdict.estimate, t.k
        assert t.truth is not None
        assert box is not None
        low, high = box.box
        assert all(a <= v <= b for a, v, b in zip(low, t.truth.x_next, high, strict=True))
    record = world.plant.state.record
    assert record.link.estimate == box, "it stands until the next transition"
    assert len(record.applied.true_x) == scenario.n


def test_a_model_misses_a_step_under_the_input_that_both_ends_reckon_with() -> None:
    """Or, where it holds, under the input in force."""
    scenario, law = law_of("encoder")
    for kind in ("zero", "hold"):
        link = scenario.link.model_copy(update={"fallback": kind})
        own = scenario.model_copy(update={"link": link})
        rule = rules_of(own).outputs
        assert rule is not None
        world = Simulation(own, law, seed=3, step_s=0.02)
        world.run(steps=20)
        record = world.plant.state.record
        missed = [e for e in effects_of(world) if isinstance(e, Missed)]
        u = record.applied.u
        for number, told in enumerate(missed):
            assert told.u == rule.instead(record.link.estimate, number, u)
            u = told.u
        assert len(missed) > 2


def effects_of(world: Simulation) -> list[Event]:
    """What the plant traces once its controller is silent."""
    told: list[Event] = []
    now = world.now_s
    while len(told) < 4:
        now = max(now, world.plant.wake_at())
        told += [e.event for e in world.plant.wake(now) if isinstance(e, Tell)]
    return told
