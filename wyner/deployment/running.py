"""The loops that run on this machine, so that others can join them without being told where.

``wyner up`` listens on ports of its own, so that two runs never meet. Each leaves a note with its
endpoints in a folder of the user's, and holds a lock on it for as long as it lives: a note that
nobody holds is of a run that ended, however it ended, and goes.
"""

import fcntl
import json
import os
import secrets
import socket
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

KNOCK_S: Final = 0.2
"""Seconds to wait for a listener on this machine."""


@dataclass(frozen=True, slots=True)
class RunningLoop:
    """One loop that can be joined.

    Parameters
    ----------
    run_dir : str
        The run's folder; also its name.
    scenario : str
    plant_management, controller_management, adversary : str
        Where its services listen.
    """

    run_dir: str
    scenario: str
    plant_management: str
    controller_management: str
    adversary: str

    def seen_from(self, folder: Path) -> str:
        """The run's folder as a path from ``folder`` where it is inside that one, else whole."""
        run_dir = Path(self.run_dir)
        inside = run_dir != folder and run_dir.is_relative_to(folder)
        return str(run_dir.relative_to(folder)) if inside else self.run_dir

    def ends_in(self, name: str) -> bool:
        """Whether a name is the folder's last parts."""
        parts = Path(name).parts
        return bool(parts) and Path(self.run_dir).parts[-len(parts) :] == parts

    def is_called(self, name: str) -> bool:
        """Whether a name is the run's folder, or the last parts of it."""
        return str(Path(name).absolute()) == self.run_dir or self.ends_in(name)


def notes_folder() -> Path:
    """The user's own folder for notes: below ``XDG_RUNTIME_DIR``, else below the temporary one.

    Raises
    ------
    OSError
        When it cannot be made, or is somebody else's.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    parent = Path(runtime) if runtime and os.access(runtime, os.W_OK) else None
    folder = parent / "wyner" if parent else Path(tempfile.gettempdir()) / f"wyner-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise OSError(f"{folder} is not a folder of this user")
    return folder


@contextmanager
def announced(loop: RunningLoop) -> Iterator[None]:
    """Keep a note of a running loop; where none can be kept, the loop runs all the same.

    The note is whole and locked before it has the name by which others find it. Processes of two
    containers that share the folder may have one number, so it is none's name.
    """
    with ExitStack() as kept:
        with suppress(OSError):
            path = notes_folder() / f"{secrets.token_hex(8)}.json"
            note = kept.enter_context(path.with_suffix(".new").open("x"))
            fcntl.flock(note, fcntl.LOCK_EX)
            json.dump(asdict(loop), note)
            note.flush()
            kept.callback(path.unlink, missing_ok=True)
            Path(note.name).rename(path)
        yield


def running_loops() -> list[RunningLoop]:
    """The loops that run now, in the order of their folders' names; stale notes are taken away."""
    try:
        notes = sorted(notes_folder().glob("*.json"))
    except OSError:
        return []
    found = [loop for note in notes if (loop := _read(note)) is not None]
    return sorted(found, key=lambda loop: loop.run_dir)


def _read(note: Path) -> RunningLoop | None:
    try:
        with note.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return RunningLoop(**json.load(file))
            note.unlink(missing_ok=True)
    except (OSError, ValueError, TypeError):
        pass  # somebody's own file
    return None


def run_names(loops: Sequence[RunningLoop]) -> str:
    """What ``--run`` takes for each: as many of its folder's last parts as no other shares."""
    told = []
    for loop in loops:
        parts = Path(loop.run_dir).parts
        tails = [str(Path(*parts[-n:])) for n in range(1, len(parts) + 1)]
        own = (t for t in tails if sum(other.ends_in(t) for other in loops) == 1)
        told.append(next(own, loop.run_dir))
    return ", ".join(told) or "none"


def listens(endpoint: str) -> bool:
    """Whether something listens at a TCP endpoint of this machine."""
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=KNOCK_S).close()
    except OSError:
        return False
    return True
