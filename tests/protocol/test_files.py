"""A file is replaced whole, whoever reads it meanwhile."""

import stat
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from runtime import status_file
from runtime.files import write_atomically
from runtime.status_file import StatusFile

Write = Callable[[bytes], None]


@pytest.fixture(params=["atomically", "as a status", "as a status, where names stay"])
def write_to(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Path], Write]:
    """Every way to replace a file."""
    if request.param == "atomically":
        return lambda path: partial(write_atomically, path)
    if request.param.endswith("stay"):
        monkeypatch.setattr(status_file, "_renameat2", None)
    return lambda path: StatusFile(path).write


def test_a_file_is_replaced_whole(tmp_path: Path, write_to: Callable[[Path], Write]) -> None:
    path = tmp_path / "status.json"
    write = write_to(path)
    for data in (b"older", b"new, and longer", b"new"):
        write(data)
        assert path.read_bytes() == data
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert {file.name for file in path.parent.iterdir()} <= {path.name, f".spare-{path.name}"}


def test_a_status_is_written_over_what_a_kill_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status_file, "READ_S", 0.0)
    path, spare = tmp_path / "status.json", tmp_path / ".spare-status.json"
    spare.write_bytes(b"half of something that is long")
    write = StatusFile(path).write
    for data in (b"1", b"22", b"3"):
        write(data)
        assert path.read_bytes() == data
    assert spare.read_bytes() == b"22"


def test_readers_never_see_a_part(tmp_path: Path, write_to: Callable[[Path], Write]) -> None:
    path = tmp_path / "status"
    contents = [bytes([i]) * 100_000 for i in range(2)]
    replace = write_to(path)
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
