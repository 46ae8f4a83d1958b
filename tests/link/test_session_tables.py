"""Both ends' tables of a session: whole, explained, and every state reached."""

from itertools import product
from types import ModuleType
from typing import get_args

import pytest

from protocol.link import controller_session, plant_session

both = pytest.mark.parametrize(
    ("end", "first"), [(plant_session, "looking"), (controller_session, "greeting")]
)


@both
def test_every_state_and_everything_heard_has_one_row(end: ModuleType, first: str) -> None:
    assert set(end.TABLE) == set(product(get_args(end.State), get_args(end.Heard)))


@both
def test_every_name_is_explained_and_used(end: ModuleType, first: str) -> None:
    assert tuple(end.STATES) == get_args(end.State)
    assert tuple(end.HEARD) == get_args(end.Heard)
    assert tuple(end.ANSWERS) == get_args(end.Answer)
    assert {row.answer for row in end.TABLE.values()} == set(end.ANSWERS)
    assert {row.next for row in end.TABLE.values()} == set(end.STATES)


@both
def test_every_state_is_reached_from_the_first(end: ModuleType, first: str) -> None:
    reached = {first}
    for _ in end.STATES:
        reached |= {end.TABLE[state, name].next for state, name in end.TABLE if state in reached}
    assert reached == set(end.STATES)
