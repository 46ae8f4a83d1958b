"""Recordings in parts of bounded size: ``trace.jsonl``, ``trace.0001.jsonl``, ...

The oldest parts are dropped where all together would outgrow their bound, and for no other reason.
"""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

_PART: Final = re.compile(r"^(?P<stem>.+?)(?:\.(?P<part>\d{4,}))?\.jsonl$")
_MIB: Final = 2**20


class Bounds(BaseModel):
    """What a recording may take on disk.

    Parameters
    ----------
    part_bytes : int
        Size at which a part ends; it ends at half of `total_bytes` in any case, so that something
        is left when the oldest is dropped.
    total_bytes : int
        Bound of all parts together, the one in use included; the oldest are dropped to keep to it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    part_bytes: int = Field(64 * _MIB, ge=1024)
    total_bytes: int = Field(1024 * _MIB, ge=2048)

    @property
    def of_a_part(self) -> int:
        """Bytes at which a part ends."""
        return min(self.part_bytes, self.total_bytes // 2)


class Parts:
    """The parts of a recording that are closed: their sizes, and which one is the oldest.

    Parameters
    ----------
    path : Path
        The first part.

    Attributes
    ----------
    bytes : int
        All of them together.
    newest : int
        Number of the last part that there was; -1 where there was none.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._sizes = {number_of(p): p.stat().st_size for p in parts_of(path)}
        self.bytes = sum(self._sizes.values())
        self.newest = max(self._sizes, default=-1)

    def __bool__(self) -> bool:
        return bool(self._sizes)

    def add(self, number: int, size: int) -> None:
        """Part ``number`` is closed."""
        self._sizes[number] = size
        self.bytes += size
        self.newest = max(self.newest, number)

    def reopen(self) -> None:
        """The newest part is being written again."""
        self.bytes -= self._sizes.pop(self.newest)

    def beyond(self, room: int) -> list[int]:
        """The oldest parts, as few of them as leave at most ``room`` bytes."""
        found, left = [], self.bytes
        for number in sorted(self._sizes):
            if left <= room:
                break
            found.append(number)
            left -= self._sizes[number]
        return found

    def oldest(self, gone: Collection[int], newest: int) -> int:
        """The oldest part there is beside ``newest``, once those that are ``gone`` are dropped."""
        return min((n for n in self._sizes if n not in gone), default=newest)

    def drop(self, number: int) -> Path:
        """Remove a part."""
        self.bytes -= self._sizes.pop(number)
        path = part_path(self._path, number)
        path.unlink(missing_ok=True)
        return path


def part_path(path: Path, number: int) -> Path:
    """The file of part ``number`` of the recording that begins at ``path``."""
    return path if number == 0 else path.with_name(f"{path.stem}.{number:04d}.jsonl")


def number_of(path: Path) -> int:
    """The number of a part, from its name."""
    match = _PART.match(path.name)
    return int(match["part"]) if match and match["part"] else 0


def first_part(path: Path) -> Path:
    """The first part of the recording that ``path`` is a part of."""
    match = _PART.match(path.name)
    return path.with_name(f"{match['stem']}.jsonl") if match else path


def parts_of(path: Path) -> list[Path]:
    """The parts of the recording at ``path`` that are on disk, in order."""
    found = [p for p in path.parent.glob(f"{path.stem}.*.jsonl") if first_part(p) == path]
    return sorted([*found, path] if path.is_file() else found, key=number_of)
