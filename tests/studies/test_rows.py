"""Rows of a study: added where they lack, and measured anew where other code made them."""

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from studies.secrecy.study import append_rows

COLUMNS = ("task", "version", "value")
NOW = "1.0.0+00000002"


class Task(NamedTuple):
    id: str


def measured(todo: list[Any]) -> Iterable[dict[str, object]]:
    return ({"task": task.id, "version": NOW, "value": "new"} for task in todo)


def rows_after(path: Path, wanted: str) -> list[list[str]]:
    append_rows(path, COLUMNS, map(Task, wanted), measured, NOW)
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == list(COLUMNS)
    return rows


def test_what_is_there_is_kept_and_a_torn_line_is_measured_again(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version,value\na,{NOW},old\nb,{NOW},o")
    assert rows_after(path, "abc") == [["a", NOW, "old"], ["b", NOW, "new"], ["c", NOW, "new"]]
    before = path.read_bytes()
    assert rows_after(path, "abc")
    assert path.read_bytes() == before


@pytest.mark.parametrize("version", ["0.1.0", "1.0.0+00000001", ""])
def test_a_row_of_other_code_is_measured_anew(version: str, tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version,value\na,{version},old\nb,0.9.0+00000002,old\n")
    assert rows_after(path, "ab") == [["b", "0.9.0+00000002", "old"], ["a", NOW, "new"]]


def test_rows_of_other_code_stay_where_they_are_not_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text("task,version,value\nz,0.1.0,old\n")
    assert rows_after(path, "a") == [["z", "0.1.0", "old"], ["a", NOW, "new"]]


def test_a_file_with_other_columns_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version\na,{NOW}\n")
    assert rows_after(path, "a") == [["a", NOW, "new"]]
