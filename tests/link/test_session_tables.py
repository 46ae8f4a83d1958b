"""Both ends' tables of a session: explained in the documents, and every state reached."""

from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest

from protocol.link import controller_session, plant_session

ROOT = Path(__file__).parents[2]

both = pytest.mark.parametrize(
    ("end", "first"), [(plant_session, "looking"), (controller_session, "greeting")]
)


@both
def test_every_name_is_explained_and_used(end: ModuleType, first: str) -> None:
    assert {row.answer for row in end.TABLE.values()} == set(get_args(end.Answer))
    assert {row.next for row in end.TABLE.values()} == set(get_args(end.State))
    page = (ROOT / "docs/protocol.md").read_text(encoding="utf-8")
    for names, form in ((end.State, "*{}*"), (end.Event, "{}"), (end.Answer, "**{}**")):
        for name in get_args(names):
            assert f"\n| {form.format(name)} | " in page, name


@both
def test_every_state_is_reached_from_the_first(end: ModuleType, first: str) -> None:
    reached = {first}
    for _ in get_args(end.State):
        reached |= {end.TABLE[state, name].next for state, name in end.TABLE if state in reached}
    assert reached == set(get_args(end.State))
