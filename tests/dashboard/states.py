"""What the dashboard knows after some steps of the rehearsed loop."""

from functools import cache

from protocol.messages import PlantStatus
from tests.support.rehearsal import Rehearsal
from wyner.dashboard.model import Arrival, State, reduce_all

USUAL = Rehearsal()


@cache
def batches(steps: int, rehearsal: Rehearsal = USUAL) -> tuple[tuple[Arrival, ...], ...]:
    return tuple(tuple(batch) for batch in rehearsal.arrivals(steps))


@cache
def state_after(steps: int, rehearsal: Rehearsal = USUAL) -> State:
    state = State()
    for batch in batches(steps, rehearsal):
        state = reduce_all(state, batch)
    return state


def plant_of(state: State) -> PlantStatus:
    assert state.plant is not None
    return state.plant
