"""How often a key store has given something, in a file of its own beside it.

A store that is put back from a copy has keys in it that were given out since, and would give them
once more. It cannot know that by itself. So whoever takes something out of a store says so here
twice: before it is written in the store, and once it is, before anybody gets it. The store's own
count then lies between the two, wherever a process dies; that of an older copy lies below.
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
"""What the file is called, after its store's name."""

_COUNTS: Final = struct.Struct("<QQ")
_CHECK: Final = struct.Struct("<I")
_SIZE: Final = _COUNTS.size + _CHECK.size


class Anchor:
    """The file beside one store.

    Parameters
    ----------
    store : Path
        The store's own file.
    """

    def __init__(self, store: Path) -> None:
        self._store = store
        self.path = store.with_name(store.name + GIVEN)

    def compare(self, given: int) -> None:
        """See that a store that has given so often is the one that was left here.

        Raises
        ------
        StoreError
            When it is an older one, or this file is not as it was written, or is gone.
        """
        with self._open(os.O_RDWR | (os.O_CREAT if given == 0 else 0)) as file:
            counted, announced = self._read(file)
            if not counted <= given <= announced:
                raise self._older(given, counted)
            if given > counted:  # whoever gave it died before it was counted
                self._write(file, given, announced)

    def look(self, given: int) -> None:
        """What :meth:`compare` sees, and nothing is written.

        Raises
        ------
        StoreError
            Where that does.
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
        """The store is about to have given so often; on return that survives a power failure.

        Raises
        ------
        StoreError
            When it had given so often before: it was put back under whoever has it open.
        """
        with self._open(os.O_RDWR) as file:
            counted, announced = self._read(file)
            if given <= counted:
                raise self._older(given - 1, counted)
            self._write(file, counted, max(announced, given))
            os.fdatasync(file)

    def count(self, given: int) -> None:
        """The store has it."""
        with self._open(os.O_RDWR) as file:
            counted, announced = self._read(file)
            self._write(file, max(counted, given), announced)

    @contextmanager
    def _open(self, flags: int, lock: int = fcntl.LOCK_EX) -> Iterator[int]:
        """One process at a time, where it writes."""
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
