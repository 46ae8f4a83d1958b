"""A file is replaced whole, whoever reads it meanwhile."""

import stat
import threading
from pathlib import Path

from runtime.files import write_atomically


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    write_atomically(path, b"older")
    write_atomically(path, b"new, and longer")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(path.parent.iterdir()) == [path]


def test_readers_never_see_a_part(tmp_path: Path) -> None:
    path = tmp_path / "status"
    contents = [bytes([i]) * 100_000 for i in range(2)]
    write_atomically(path, contents[0])
    done = threading.Event()

    def write() -> None:
        for i in range(200):
            write_atomically(path, contents[i % 2])
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    seen = set()
    while not done.is_set():
        seen.add(path.read_bytes())  # and never that it is not there
    writer.join()
    assert seen <= set(contents)
