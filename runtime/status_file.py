"""A status: a file that is replaced again and again, and read from outside at any moment."""

import ctypes
import errno
import os
import time
from pathlib import Path
from typing import Final

from runtime.files import open_private, refuse_irregular

READ_S: Final = 0.5
"""Longest time from the opening of a status to its having been read."""


class StatusFile:
    """A file that is replaced again and again, whole for every reader.

    A new content is written over the last but one, and the two files exchange their names. To make
    a file each time and rename it takes five times the processor time, and ext4 writes each one out
    to the disk first. What a power cut leaves of a status matters to nobody, and what a kill leaves
    half written is written over.

    Parameters
    ----------
    path : Path
        In a folder that no one else writes into.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._spare = path.with_name(f".spare-{path.name}")
        self._written_s = time.monotonic()  # whatever is there may be read right now

    def write(self, data: bytes) -> None:
        """Replace the file.

        Raises
        ------
        OSError
            With the file's name; also when there is something else than a regular file.
        """
        refuse_irregular(self.path)
        if time.monotonic() - self._written_s < READ_S:  # the last but one may still be read
            self._spare.unlink(missing_ok=True)
        file = open_private(self._spare, os.O_WRONLY | os.O_CREAT)
        try:
            if os.write(file, data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.ftruncate(file, len(data))
        except OSError as error:  # what is done to a file that is open does not name it
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        finally:
            os.close(file)
        if not _exchange(self._spare, self.path):  # it is the first, or the system cannot
            self._spare.replace(self.path)
        self._written_s = time.monotonic()


def _exchange(one: Path, other: Path) -> bool:
    """Exchange the names of two files; False where that is not possible."""
    return _renameat2 is not None and not _renameat2(
        _AT_FDCWD, bytes(one), _AT_FDCWD, bytes(other), _RENAME_EXCHANGE
    )


_renameat2: Final = getattr(ctypes.CDLL(None), "renameat2", None)
"""Of Linux's C library, which alone exchanges names."""

_AT_FDCWD: Final = -100
_RENAME_EXCHANGE: Final = 2
