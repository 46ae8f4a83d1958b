"""A run's folder: its owner's alone, and nothing written where it must not be."""

import os
import stat
from pathlib import Path

import pytest

from runtime.files import (
    PUBLIC_FILE,
    open_private,
    replacing,
    write_atomically,
)
from runtime.journal import PlantJournal
from runtime.recording import LineWriter, TraceWriter, read_lines
from runtime.status_file import StatusFile


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_folders_and_files_are_the_owners_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        run = tmp_path / "runs" / "one"
        TraceWriter(run / "plant" / "trace.jsonl", "plant", {}).close()
        PlantJournal(run / "plant" / "journal.sqlite3", "0" * 64).close()
        write_atomically(run / "manifest.json", b"{}")
        write_atomically(tmp_path / "public.json", b"{}", PUBLIC_FILE)
    finally:
        os.umask(before)
    found = [run, *run.rglob("*")]
    assert len(found) >= 5
    assert {mode(p) for p in found if p.is_dir()} == {0o700}
    assert {mode(p) for p in found if p.is_file()} == {0o600}
    assert mode(tmp_path / "runs") == 0o700
    assert mode(tmp_path / "public.json") == 0o644


@pytest.mark.parametrize("kind", ["link", "pipe", "dangling"])
def test_what_is_no_regular_file_is_left_as_it_is(tmp_path: Path, kind: str) -> None:
    path, target = tmp_path / kind, tmp_path / "target"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(target)
    if kind == "link":
        target.write_bytes(b"mine")
    for write in (
        lambda: write_atomically(path, b"x"),
        lambda: StatusFile(path).write(b"x"),
        lambda: open_private(path, os.O_WRONLY | os.O_CREAT),
    ):
        with pytest.raises(OSError, match="not a regular file") as error:
            write()
        assert error.value.filename == str(path)
    assert path.is_fifo() if kind == "pipe" else path.is_symlink()
    assert target.exists() == (kind == "link")
    assert len(list(tmp_path.iterdir())) == 1 + (kind == "link")


def test_a_replacement_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "f"
    write_atomically(path, b"old")
    with pytest.raises(ZeroDivisionError), replacing(path) as partial:
        partial.write_bytes(b"half")
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_lives_and_their_end_marks(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    for _ in range(2):
        writer = LineWriter(path, {"who": "me"})
        writer.append(b'{"event":"a"}')
        writer.append(b'{"event":"b"}', b"[1]")
        writer.close(last=True)
        writer.close()
    lines = list(read_lines(path))
    assert [line.number for line in lines] == list(range(1, 11))
    assert [line.value and line.value["event"] for line in lines[:5]] == [
        *("header", "a", "b", None, "end")
    ]
    assert lines[5].value == {"event": "continued"}
    ends = [lines[4].value, lines[9].value]
    assert all(end and end["lines"] == 4 and end["last"] for end in ends)
    assert writer.size == path.stat().st_size
