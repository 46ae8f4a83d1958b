"""How often a key store has given something, counted in a second file beside it.

A store that is put back from a copy holds keys that were given since, and cannot know it. So the
file beside it has two counts. The first is raised before the store is written, the second after,
and only then does anybody get the key. Wherever a process dies, the store's own count lies between
the two. That of an older copy lies below.
"""

import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final
from zlib import crc32

from protocol.secret.records import StoreError
from runtime.files import open_private

GIVEN: Final = "-given"
"""Suffix of the file's name, after its store's name."""

_COUNTS: Final = struct.Struct("<QQ")
_CHECK: Final = struct.Struct("<I")
_SIZE: Final = _COUNTS.size + _CHECK.size


class Anchor:
    """The counts beside one store.

    Parameters
    ----------
    store : Path
        The store's own file.
    """

    def __init__(self, store: Path) -> None:
        self._store = store
        self.path = store.with_name(store.name + GIVEN)

    def compare(self, given: int) -> None:
        """Check that a store that has given ``given`` times is no older copy.

        Raises
        ------
        StoreError
            When it is one, or this file is damaged or gone.
        """
        with self._open(os.O_RDWR | (os.O_CREAT if given == 0 else 0)) as file:
            counted, announced = self._read(file)
            if not counted <= given <= announced:
                raise self._older(given, counted)
            if given > counted:  # whoever gave it died before it was counted
                self._write(file, given, announced)

    def look(self, given: int) -> None:
        """Check as :meth:`compare` does, and write nothing.

        Raises
        ------
        StoreError
            As :meth:`compare`.
        """
        if given == 0 and not self.path.exists():
            return
        with self._open(os.O_RDONLY, fcntl.LOCK_SH) as file:
            counted, announced = self._read(file)
        if not counted <= given <= announced:
            raise self._older(given, counted)

    def _older(self, given: int, counted: int) -> StoreError:
        return StoreError(
            f"{self._store}: has given {given} times, and {self.path.name} counts {counted}: "
            "one of the two is an older copy, and keys would be given twice; remove both"
        )

    def announce(self, given: int) -> None:
        """Note that the store is about to have given ``given`` times. It survives a power failure.

        Raises
        ------
        StoreError
            When that count was reached before: the store was put back while it is open.
        """
        with self._open(os.O_RDWR) as file:
            counted, announced = self._read(file)
            if given <= counted:
                raise self._older(given - 1, counted)
            self._write(file, counted, max(announced, given))
            os.fdatasync(file)

    def count(self, given: int) -> None:
        """Note that the store has given ``given`` times."""
        with self._open(os.O_RDWR) as file:
            counted, announced = self._read(file)
            self._write(file, max(counted, given), announced)

    @contextmanager
    def _open(self, flags: int, lock: int = fcntl.LOCK_EX) -> Iterator[int]:
        """Open the file; a writer has it alone."""
        try:
            file = open_private(self.path, flags)
        except FileNotFoundError:
            raise StoreError(
                f"{self.path}: is gone: nobody can tell whether {self._store.name} is an older "
                "copy, and keys would be given twice; remove that one, too"
            ) from None
        except OSError as error:
            raise StoreError(f"{self.path}: {error.strerror}") from None
        try:
            fcntl.flock(file, lock)
            yield file
        except OSError as error:
            raise StoreError(f"{self.path}: {error.strerror}") from None
        finally:
            with suppress(OSError):
                os.close(file)

    def _read(self, file: int) -> tuple[int, int]:
        data = os.pread(file, _SIZE + 1, 0)
        if not data:
            return 0, 0
        body = data[: _COUNTS.size]
        if len(data) != _SIZE or _CHECK.pack(crc32(body)) != data[_COUNTS.size :]:
            raise StoreError(
                f"{self.path}: not as it was written: nobody can tell whether {self._store.name} "
                "is an older copy; remove both"
            )
        counted, announced = _COUNTS.unpack(body)
        return counted, announced

    @staticmethod
    def _write(file: int, counted: int, announced: int) -> None:
        body = _COUNTS.pack(counted, announced)
        os.pwrite(file, body + _CHECK.pack(crc32(body)), 0)
