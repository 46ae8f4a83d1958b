"""Rows of a study: added where they lack, and measured anew where other code made them."""

import csv
from collections.abc import Iterator
from pathlib import Path

import pytest

from studies.registry import Study

HEAD = ["task", "version", "value"]


class Letters(Study):
    """A study whose tasks are letters; it is of the code that a test says."""

    @property
    def version(self) -> str:
        return NOW

    def id(self, task: str) -> str:
        return task


NOW = "1.0.0+00000002"


def measured(task: str) -> Iterator[tuple[str]]:
    if task == "!":
        raise RuntimeError
    yield ("new",)
    if task == "d":
        yield ("second",)


def rows_after(path: Path, wanted: str) -> list[list[str]]:
    Letters("some", ("value",), lambda: wanted, measured, __name__).measure(path)
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == HEAD
    return rows


def test_what_is_there_is_kept_and_a_torn_line_is_measured_again(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version,value\na,{NOW},old\nb,{NOW},o")
    assert rows_after(path, "abc") == [["a", NOW, "old"], ["b", NOW, "new"], ["c", NOW, "new"]]
    before = path.read_bytes()
    assert rows_after(path, "abc")
    assert path.read_bytes() == before


def test_a_task_that_was_torn_between_its_rows_is_measured_again(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version,value\na,{NOW},old\nd,{NOW},new\nd,{NOW},sec")
    assert rows_after(path, "ad") == [["a", NOW, "old"], ["d", NOW, "new"], ["d", NOW, "second"]]


def test_a_task_that_fails_loses_no_other(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    with pytest.raises(RuntimeError):
        rows_after(path, "a!")
    assert rows_after(path, "a") == [["a", NOW, "new"]]


@pytest.mark.parametrize("version", ["0.1.0", "1.0.0+00000001", ""])
def test_a_row_of_other_code_is_measured_anew(version: str, tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version,value\na,{version},old\nb,0.9.0+00000002,old\n")
    assert rows_after(path, "ab") == [["a", NOW, "new"], ["b", "0.9.0+00000002", "old"]]


def test_rows_of_other_code_stay_where_they_are_not_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text("task,version,value\nz,0.1.0,old\n")
    assert rows_after(path, "a") == [["z", "0.1.0", "old"], ["a", NOW, "new"]]


def test_a_file_with_other_columns_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "some.csv"
    path.write_text(f"task,version\na,{NOW}\n")
    assert rows_after(path, "a") == [["a", NOW, "new"]]


def test_nothing_is_an_empty_cell() -> None:
    one = Letters("some", ("value",), tuple, lambda _: [(None,)], __name__)
    assert one.measured("a")[0]["value"] == ""
