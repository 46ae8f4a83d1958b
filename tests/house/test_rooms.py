"""The Makefile's rooms: each folder of tests belongs to one, and to one only."""

import re
from pathlib import Path

from tests.conftest import LONGEST, TESTS

ROOT = Path(__file__).resolve().parents[2]
APART = {"compose", "support"}
"""Containers have a target of their own; what tests share has no tests."""


def test_each_folder_of_tests_is_run_by_one_room() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = " ".join(re.findall(r"^ROOM_[a-z]+ := (.*)$", text, re.MULTILINE)).split()
    folders = {path.parent.name for path in (ROOT / "tests").glob("*/__init__.py")}
    assert sorted(named) == sorted(folders - APART)


def test_a_target_that_is_also_a_folder_is_always_made() -> None:
    """`make paper` found the folder paper, called it up to date, and made nothing."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    phony = " ".join(re.findall(r"^\.PHONY: (.*)$", text, re.MULTILINE)).split()
    targets = re.findall(r"^([a-z-]+):", text, re.MULTILINE)
    assert "paper" in targets
    assert not {name for name in targets if name not in phony}


def test_the_files_that_go_first_are_there() -> None:
    assert all((TESTS / name).is_file() for name in LONGEST)
