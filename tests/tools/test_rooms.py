"""Rooms are counted by their files."""

import pytest

from tools.rooms import Size, main, sizes, table

FILES = [
    ("setup.py", "x = 1\n"),
    ("link/a.py", "class A:\n    def f(self): ...\n"),
    ("link/deep/b.py", "async def g(): ...\n\n\ndef h(): ...\n"),
    ("link/notes.md", "class of its own\n"),
    ("tap/c.py", ""),
]


def test_a_room_is_the_sum_of_its_python_files() -> None:
    assert sizes(FILES) == {"link": Size(2, 6, 1, 3), "tap": Size(1, 0, 0, 0)}


def test_what_went_counts_nothing_afterwards() -> None:
    shown = table({"old": sizes(FILES), "new": sizes(FILES[1:3])})
    assert shown.splitlines()[-1].split() == ["tap", "1", "0", "0", "0", "0", "0", "0", "0"]


def test_an_unknown_revision_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no-such-revision"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("rooms: ")
    assert err.count("\n") == 1
