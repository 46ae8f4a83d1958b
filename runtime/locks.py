"""Which process uses a run's folder: a lock that ends with the process, however that one ends."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from runtime.errors import UsageError, writing
from runtime.files import make_folder, open_private, open_regular


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a service's folder; the lock goes with the process, however that one ends.

    Raises
    ------
    UsageError
        When it cannot be made or written to, or another process holds it.
    Failure
        When the disk is full or broken.
    """
    with writing(f"--run-dir: {folder}"):
        make_folder(folder)
        file = os.fdopen(open_private(folder / "lock", os.O_WRONLY | os.O_CREAT), "wb")
    with file:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(f"--run-dir: {folder}: another process is using it") from None
        yield


def refuse_running(run_dir: Path) -> None:
    """Refuse a run whose services still write.

    Raises
    ------
    UsageError
        When a process holds an end's journal, or a tap's folder as :func:`alone_in` does.
    """
    kept = (*run_dir.glob("*/journal.sqlite3"), *run_dir.glob("*/lock"))
    if running := sorted({file.parent.name for file in kept if _is_held(file)}):
        names = ", ".join(running)
        raise UsageError(f"{run_dir}: {names} still at work, expected a run that has ended")


def _is_held(file: Path) -> bool:
    try:
        with open_regular(file) as opened:
            fcntl.lockf(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # whoever may not read it is told so by what reads it
        pass
    return False
