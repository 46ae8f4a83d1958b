"""How much processor time a guest and all that it started may use."""

import mmap
import os
import resource
import struct
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

PROCESSOR_S: Final = 5.0
"""Seconds of processor time that a guest, with all that it started, has beside its answers. For an
answer it has as much as the answer may take, for one core."""

PROCESSOR_SHARE: Final = 0.05
"""Share of one core that a guest has besides, for as long as it lives."""

LOADING_S: Final = 20.0
"""Seconds of processor time that loading a guest may take."""

_METER: Final = struct.Struct("ddd")


class Meter:
    """What processor time a guest may have used; the guest and its supervisor share it.

    Parameters
    ----------
    now : float, optional
        Monotonic seconds.
    """

    def __init__(self, now: float | None = None) -> None:
        self._began = time.monotonic() if now is None else now
        self._kept = mmap.mmap(-1, _METER.size)
        self._put(-1.0, 0.0, 0.0)  # nothing asked so far: it is being loaded

    def _put(self, earned_s: float, asked: float, within_s: float) -> None:
        _METER.pack_into(self._kept, 0, earned_s, asked, within_s)

    def ask(self, within_s: float, now: float, loading_s: float) -> None:
        """It is asked something; ``loading_s`` is what it took to be loaded, the first time."""
        earned = _METER.unpack_from(self._kept)[0]
        self._put(loading_s if earned < 0 else earned, now, within_s)

    def answer(self, now: float) -> None:
        """It has answered."""
        earned, asked, within_s = _METER.unpack_from(self._kept)
        self._put(earned + min(now - asked, within_s), 0.0, 0.0)

    def overspent(self, used_s: float, now: float) -> bool:
        """Whether ``used_s`` seconds of processor time up to ``now`` are too many."""
        earned, asked, within_s = _METER.unpack_from(self._kept)
        if earned < 0:
            earned = LOADING_S
        if asked:
            earned += min(now - asked, within_s)
        return bool(used_s > earned + PROCESSOR_S + PROCESSOR_SHARE * (now - self._began))


def used_s() -> float:
    """Seconds of processor time of this process's descendants, without its own."""
    mine = os.getpid()
    stats = _stats()
    running = _family(mine, stats) - {mine}
    gone = resource.getrusage(resource.RUSAGE_CHILDREN)
    return _seconds(running, stats) + gone.ru_utime + gone.ru_stime


def used_by_s(child: int) -> float:
    """Seconds of processor time of one process and of all that comes from it."""
    stats = _stats()
    return _seconds(_family(child, stats), stats)


def _stats() -> dict[int, tuple[int, int]]:
    """Parent and clock ticks of each process; the ticks of its ended children are included."""
    stats: dict[int, tuple[int, int]] = {}
    for process in processes():
        with suppress(OSError):
            told = (process / "stat").read_bytes().decode(errors="replace")
            fields = told.rpartition(")")[2].split()
            stats[int(process.name)] = int(fields[1]), sum(map(int, fields[11:15]))
    return stats


def _family(ancestor: int, stats: Mapping[int, tuple[int, int]]) -> set[int]:
    family = {ancestor}
    known = 0
    while known < len(family):
        known = len(family)
        family |= {pid for pid, (parent, _) in stats.items() if parent in family}
    return family


def _seconds(family: set[int], stats: Mapping[int, tuple[int, int]]) -> float:
    ticks = sum(stats[pid][1] for pid in family if pid in stats)
    return ticks / os.sysconf("SC_CLK_TCK")


def processes() -> list[Path]:
    """The folder of each process there is."""
    return [path for path in Path("/proc").iterdir() if path.name.isdigit()]
