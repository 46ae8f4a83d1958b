"""What the dashboard knows after some steps of the rehearsed loop."""

from functools import cache

from protocol.messages import ControllerStatus, PlantStatus
from tests.support.rehearsal import Rehearsal
from tests.support.statuses import changed
from wyner.dashboard.model import Arrival, State, reduce, reduce_all

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


def with_plant(state: State, **changes: object) -> State:
    """The state after one more plant status; the step stands still unless it is changed."""
    return _later(state, plant_of(state), changes)


def with_controller(state: State, **changes: object) -> State:
    """The state after one more controller status."""
    assert state.controller is not None
    return _later(state, state.controller, changes)


def _later(
    state: State, status: PlantStatus | ControllerStatus, changes: dict[str, object]
) -> State:
    at = {"seq": status.seq + 1, "t_ns": status.t_ns + 1}
    return reduce(state, Arrival(state.seen["plant"] + 1, changed(status, **{**at, **changes})))
