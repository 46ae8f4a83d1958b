"""A file is replaced whole, whoever reads it meanwhile."""

import os
import stat
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from runtime import files
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
    beside = {path.with_name(".spare-status.json")} if way is as_status else set()
    assert {*path.parent.iterdir()} == {path, *beside}


def test_a_status_takes_the_place_of_the_one_before_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "status.json"
    write = as_status(path)
    for data in (b"first", b"second"):
        write(data)
    before = {file.stat().st_ino for file in tmp_path.iterdir()}
    monkeypatch.setattr(files, "READ_S", 0.0)
    for data in (b"third, and longer", b"4"):
        write(data)
        assert path.read_bytes() == data
        assert {file.stat().st_ino for file in tmp_path.iterdir()} == before


def test_whoever_has_opened_a_status_reads_it_though_two_more_are_written(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    write = as_status(path)
    write(b"first")
    write(b"second")
    with path.open("rb") as reader:
        for data in (b"third", b"4"):
            write(data)
        assert reader.read() == b"second"


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


def test_a_status_is_replaced_where_names_cannot_be_exchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "renameat2", None)
    write = as_status(tmp_path / "f")
    for data in (b"old", b"new"):
        write(data)
    assert (tmp_path / "f").read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [tmp_path / "f"]


def test_the_same_status_is_not_written_again_and_its_time_says_when_it_was_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "health"
    write = as_status(path)
    write(b"ok")
    with monkeypatch.context() as writing:
        writing.setattr(os, "write", lambda *_: pytest.fail("written again"))
        os.utime(path, (0, 0))
        write(b"ok")
        assert time.time() - path.stat().st_mtime < 30
    path.unlink()
    write(b"ok")
    assert path.read_bytes() == b"ok", "unless it is gone"
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(NotRegular):
        write(b"ok")


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
