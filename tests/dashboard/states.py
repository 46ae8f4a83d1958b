"""What the dashboard knows after some steps of the rehearsed loop."""

from functools import cache

from protocol.messages import ControllerStatus, PlantStatus
from tests.support.rehearsal import Rehearsal
from tests.support.statuses import changed
from wyner.dashboard.model import Arrival, LoopState, reduce, reduce_all

USUAL = Rehearsal()


@cache
def batches(steps: int, rehearsal: Rehearsal = USUAL) -> tuple[tuple[Arrival, ...], ...]:
    return tuple(tuple(batch) for batch in rehearsal.arrivals(steps))


@cache
def state_after(steps: int, rehearsal: Rehearsal = USUAL) -> LoopState:
    state = LoopState()
    for batch in batches(steps, rehearsal):
        state = reduce_all(state, batch)
    return state


def plant_of(state: LoopState) -> PlantStatus:
    assert state.plant is not None
    return state.plant


def with_plant(state: LoopState, **changes: object) -> LoopState:
    """The state after one more plant status; the step stands still unless it is changed."""
    return _later(state, plant_of(state), changes)


def with_controller(state: LoopState, **changes: object) -> LoopState:
    """The state after one more controller status."""
    assert state.controller is not None
    return _later(state, state.controller, changes)


def _later(
    state: LoopState, status: PlantStatus | ControllerStatus, changes: dict[str, object]
) -> LoopState:
    at = {"seq": status.seq + 1, "t_ns": status.t_ns + 1}
    return reduce(state, Arrival(state.seen["plant"] + 1, changed(status, **{**at, **changes})))
