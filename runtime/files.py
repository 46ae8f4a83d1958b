"""Files that are their owner's alone, and files that are replaced whole.

A run leaves its message, keys, coins and journals on disk. So folders made here are 0700 and files
0600, whatever the umask says, and nothing is ever written through a link or onto a device.
"""

import errno
import os
import stat
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final

from runtime.errors import UsageError

PRIVATE_FILE: Final = 0o600
PRIVATE_FOLDER: Final = 0o700
PUBLIC_FILE: Final = 0o644
"""Mode of files that are published on purpose; the umask narrows it."""

AT_ONCE: Final = (
    getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
)
"""Flags of an open that waits for no pipe, and whose file no child inherits. Windows has neither,
and has a flag that leaves the bytes as they are."""

NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)
"""Flag of an open that follows no link; Windows lacks it."""


class NotRegular(OSError):
    """Something that is no regular file stands where a file was to be written or read."""

    def __init__(self, path: Path) -> None:
        what = "not a regular file (a link, a device, a pipe or a socket)"
        super().__init__(errno.EINVAL, what, str(path))


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
    file = os.open(path, os.O_RDONLY | AT_ONCE)
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
        raise NotRegular(path)


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


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a file.

    Raises
    ------
    UsageError
        With one line, when it cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(read_regular(path).decode())
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise UsageError(f"{path}: cannot be read: {reason}") from None
    except (ValueError, RecursionError) as error:  # also of a huge number, or of nested brackets
        raise UsageError(f"{path}: not TOML: {error}") from None


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
    _expect_regular(path, mode)


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
    file = os.open(path, flags | NO_LINK | AT_ONCE, PRIVATE_FILE)
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
    os.close(handle)
    partial = Path(name)
    try:
        if mode != PRIVATE_FILE:
            umask = os.umask(0)
            os.umask(umask)
            partial.chmod(mode & ~umask)
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_atomically(path: Path, data: bytes, mode: int = PRIVATE_FILE) -> None:
    """Replace a file whole, as :func:`replacing` does.

    Raises
    ------
    OSError
        With the file's name; also when ``path`` is no regular file.
    """
    with replacing(path, mode) as partial:
        try:
            partial.write_bytes(data)
        except OSError as error:  # what is done to a file that is open does not name it
            raise OSError(error.errno, error.strerror, str(path)) from None


def cache_folder(kind: str) -> Path:
    """Where designs are kept: ``$XDG_CACHE_HOME/wyner/KIND``, else ``~/.cache/wyner/KIND``.

    A user without a home is given a folder that cannot be made: nothing is kept.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    if base and Path(base).is_absolute():
        return Path(base) / "wyner" / kind
    try:
        home = Path.home()
    except RuntimeError:
        home = Path(os.devnull)
    return home / ".cache" / "wyner" / kind
