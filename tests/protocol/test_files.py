"""A file is replaced whole, whoever reads it meanwhile."""

import stat
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from runtime.files import StatusFile, write_atomically

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
