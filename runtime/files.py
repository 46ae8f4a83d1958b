"""Files that are their owner's alone, and files that are replaced whole.

A run leaves its message, keys, coins and journals on disk. So folders made here are 0700 and files
0600, whatever the umask says, and nothing is ever written through a link or onto a device.
"""

import ctypes
import errno
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

PRIVATE_FILE: Final = 0o600
PRIVATE_FOLDER: Final = 0o700
PUBLIC_FILE: Final = 0o644
"""Mode of files that are published on purpose; the umask narrows it."""


class NotRegular(OSError):
    """Something that is no regular file stands where a file was to be written or read."""

    def __init__(self, path: Path, what: str = "a link, a device or a pipe") -> None:
        super().__init__(errno.EINVAL, f"not a regular file ({what})", str(path))


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file to read it: the one way in which files that a user names are opened.

    A pipe in its place would be waited at for ever, and a device may have no end.

    Raises
    ------
    NotRegular
        When it is something else, also behind a link.
    OSError
        With the file's name, when it cannot be opened.
    """
    _expect_regular(path, path.stat().st_mode)  # a device may act on being opened
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _expect_regular(path, os.fstat(file).st_mode)
    except OSError:
        os.close(file)
        raise
    return os.fdopen(file, "rb")


def _expect_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise NotRegular(path, "a device, a pipe or a socket")


def read_regular(path: Path) -> bytes:
    """All of a regular file.

    Raises
    ------
    NotRegular
    OSError
        With the file's name, when it cannot be read.
    """
    with open_regular(path) as file:
        return file.read()


def make_folder(folder: Path) -> None:
    """Make a folder and those above it that are missing, for their owner alone.

    One that is there keeps its mode.

    Raises
    ------
    OSError
        When it cannot be made.
    """
    for missing in reversed([f for f in (folder, *folder.parents) if not f.exists()]):
        missing.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))


def refuse_irregular(path: Path) -> None:
    """Leave what is no regular file alone; a path where nothing is passes.

    Raises
    ------
    NotRegular
        When ``path`` is a link, a device, a pipe or a socket.
    OSError
        When the path cannot be looked at, as when its name is too long.
    """
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise NotRegular(path)


def open_private(path: Path, flags: int) -> int:
    """Open a regular file with ``flags``, made 0600 where it is new; never follows a link.

    Raises
    ------
    NotRegular
        When it is something else.
    OSError
        With the file's name, when it cannot be opened.
    """
    refuse_irregular(path)
    file = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, PRIVATE_FILE)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise NotRegular(path)
    return file


@contextmanager
def replacing(path: Path, mode: int = PRIVATE_FILE) -> Iterator[Path]:
    """A new file to write beside ``path``, which takes its place at the end, whole.

    It is removed when something fails. Readers see the old content or the new, never a part.

    Parameters
    ----------
    path : Path
        Its folder is made where it is missing.
    mode : int
        The file's permissions; the umask narrows all but `PRIVATE_FILE`.

    Raises
    ------
    NotRegular
        When ``path`` is there and is no regular file; it is left as it is.
    OSError
    """
    refuse_irregular(path)
    if mode == PRIVATE_FILE:
        make_folder(path.parent)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".partial-", dir=path.parent)
    partial = Path(name)
    try:
        if mode != PRIVATE_FILE:
            umask = os.umask(0)
            os.umask(umask)
            os.fchmod(handle, mode & ~umask)
        os.close(handle)
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_atomically(path: Path, data: bytes, mode: int = PRIVATE_FILE) -> None:
    """Replace a file whole, as :func:`replacing` does.

    Raises
    ------
    OSError
        Also when ``path`` is no regular file.
    """
    with replacing(path, mode) as partial:
        partial.write_bytes(data)


READ_S: Final = 0.5
"""How long a reader may take from opening a status to having read it."""


class StatusFile:
    """A file that is written again and again, whole for every reader, without the disk.

    It is written beside ``path``, over the status before last, and the two exchange names. Renaming
    over a file makes ext4 write the new one out first (1 ms in the median, 5 ms at times), and
    making and removing one each time took 0.1 to 0.7 ms of processor time; this takes 0.03.
    One that stood there within :data:`READ_S` may still be read, and is left alone. What is the
    same as before is not written again: the file's time says when it was said last.
    What a power cut would leave of a status matters to nobody.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._spare = path.with_name(f".spare-{path.name}")
        self._there = b""
        self._exchanged_s = time.monotonic()  # whatever is there may be read right now

    def write(self, data: bytes) -> None:
        """Replace the file.

        Raises
        ------
        NotRegular
            When something else stands there; it is left as it is.
        OSError
            Also when there is no room.
        """
        refuse_irregular(self._path)
        if data == self._there:
            with suppress(FileNotFoundError):
                os.utime(self._path, follow_symlinks=False)
                return
        if time.monotonic() - self._exchanged_s < READ_S:
            self._spare.unlink(missing_ok=True)
        file = open_private(self._spare, os.O_WRONLY | os.O_CREAT)
        try:
            if os.write(file, data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.ftruncate(file, len(data))
        except OSError as error:  # what is done to a file that is open does not name it
            raise OSError(error.errno, error.strerror, str(self._path)) from None
        finally:
            os.close(file)
        if not _exchange(self._spare, self._path):  # nothing there yet, or a system that cannot
            self._spare.replace(self._path)
        self._there, self._exchanged_s = data, time.monotonic()


def _exchange(one: Path, other: Path) -> bool:
    """Exchange the names of two regular files at once; tells whether that could be done."""
    return renameat2 is not None and (
        renameat2(_AT_FDCWD, bytes(one), _AT_FDCWD, bytes(other), _RENAME_EXCHANGE) == 0
    )


renameat2: Final = getattr(ctypes.CDLL(None), "renameat2", None)
"""Of Linux's C library; others rename."""

_AT_FDCWD: Final = -100
_RENAME_EXCHANGE: Final = 2
