"""A file is replaced whole, whoever reads it meanwhile."""

import os
import stat
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from runtime.files import NotRegular, StatusFile, write_atomically

Write = Callable[[bytes], None]


def atomically(path: Path) -> Write:
    return lambda data: write_atomically(path, data)


def as_status(path: Path) -> Write:
    return StatusFile(path).write


WAYS: list[Callable[[Path], Write]] = [atomically, as_status]


@pytest.mark.parametrize("way", WAYS)
def test_a_file_is_replaced_whole(tmp_path: Path, way: Callable[[Path], Write]) -> None:
    path = tmp_path / "status.json"
    write = way(path)
    write(b"older")
    write(b"old")
    write(b"new, and longer")
    assert path.read_bytes() == b"new, and longer"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(path.parent.iterdir()) == [path]


def test_whoever_has_opened_a_status_reads_it_though_two_more_are_written(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    write = as_status(path)
    write(b"first")
    write(b"second")
    with path.open("rb") as reader:
        for data in (b"third", b"4"):
            write(data)
        assert reader.read() == b"second"


def test_a_status_is_written_where_a_process_that_died_was_writing(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    path.with_name(".spare-status.json").write_bytes(b"half of one, and longer than the next")
    as_status(path)(b"new")
    assert path.read_bytes() == b"new"
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(NotRegular):
        as_status(path)(b"ok")


def test_a_status_for_which_there_is_no_room_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "status.json"
    write = as_status(path)
    write(b"old")
    monkeypatch.setattr(os, "write", lambda _file, data: len(data) - 1)
    with pytest.raises(OSError, match="No space left"):
        write(b"new")
    assert path.read_bytes() == b"old"


def test_what_a_killed_writer_left_of_a_status_harms_nobody(tmp_path: Path) -> None:
    (tmp_path / ".spare-f").write_bytes(b"half of something long")
    as_status(tmp_path / "f")(b"new")
    assert (tmp_path / "f").read_bytes() == b"new"


@pytest.mark.parametrize("way", WAYS)
def test_readers_never_see_a_part(tmp_path: Path, way: Callable[[Path], Write]) -> None:
    path = tmp_path / "status"
    contents = [bytes([i]) * 100_000 for i in range(2)]
    replace = way(path)
    replace(contents[0])
    done = threading.Event()

    def write() -> None:
        for i in range(200):
            replace(contents[i % 2])
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    seen = set()
    while not done.is_set():
        seen.add(path.read_bytes())  # and never that it is not there
    writer.join()
    assert seen <= set(contents)
